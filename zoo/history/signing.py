"""Signatures of releases: Ed25519 over a release's name and root, by a key in a PEM file.

    openssl genpkey -algorithm ed25519 -out key.pem
    openssl pkey -in key.pem -pubout -out key.pub.pem

They need `cryptography`, of the extra `sign`; reading a registry does not.
"""

from pathlib import Path
from typing import Any

from assistax_base.errors import SignatureError, shorten
from assistax_base.extras import optional

MAX_KEY_BYTES = 64 * 1024


def sign(release: str, root: str, key: Path) -> str:
    """Return the signature in hex of a release by a private key, PEM without a password.

    Raises:
        SignatureError: The file holds no such key.
        ValueError: `cryptography` is not installed.
    """
    return _load(key, private=True).sign(_message(release, root)).hex()


def check_signature(release: str, root: str, signature: str | None, key: Path) -> str | None:
    """Return the problem of a release's signature; None if it is valid. The key is public, in PEM.

    Raises:
        SignatureError: The file holds no such key.
    """
    public = _load(key, private=False)
    from cryptography.exceptions import InvalidSignature

    if signature is None:
        return f"release {release} is not signed"
    try:
        public.verify(bytes.fromhex(signature), _message(release, root))
    except InvalidSignature:
        return f"release {release} is not signed by the key in {key}"
    return None


def _message(release: str, root: str) -> bytes:
    return f"assistax-zoo release {release} {root}".encode()


def _load(key: Path, private: bool) -> Any:
    optional("cryptography", "a signature", "sign")
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ed25519

    kind = ed25519.Ed25519PrivateKey if private else ed25519.Ed25519PublicKey
    try:
        with key.open("rb") as file:
            data = file.read(MAX_KEY_BYTES)
        loaded = (
            serialization.load_pem_private_key(data, None)
            if private
            else serialization.load_pem_public_key(data)
        )
        if isinstance(loaded, kind):
            return loaded
        reason = f"a {type(loaded).__name__}"
    except (OSError, ValueError, TypeError, UnsupportedAlgorithm) as error:
        reason = shorten(str(error))
    side = "private" if private else "public"
    raise SignatureError(f"key {key}", f"an Ed25519 {side} key in PEM, without a password", reason)
