"""Receipts: signed statements of a score, checked without the server.

Ed25519 (RFC 8032) over the canonical JSON of the content. The key is made when a server first
starts, and lies in its data folder.
"""

import base64
import hmac
from pathlib import Path
from typing import Any

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from assistax_base.digest import canonical_json
from assistax_base.files import OWNER, atomic_write

KEY_FILE = "signing-key.pem"


class Signer:
    """Signs receipts with one private key."""

    def __init__(self, key: Ed25519PrivateKey) -> None:
        self._key = key

    @property
    def public_key(self) -> str:
        """The public half, as base64 of its 32 bytes; `receipt verify --key` takes it."""
        return base64.b64encode(self._key.public_key().public_bytes_raw()).decode("ascii")

    def secret(self, purpose: str) -> bytes:
        """Return a secret that follows from this key, another one for each purpose."""
        return hmac.digest(self._key.private_bytes_raw(), purpose.encode(), "sha256")

    def sign(self, content: dict[str, Any]) -> str:
        """Return the signature of a content, as base64."""
        return base64.b64encode(self._key.sign(canonical_json(content))).decode("ascii")


def load_signer(folder: Path) -> Signer:
    """Return the signer of a data folder; a new folder gets a key that only its owner can read."""
    path = folder / KEY_FILE
    if not path.is_file():
        key = Ed25519PrivateKey.generate()
        pem = key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
        atomic_write(path, pem, OWNER)
    loaded = serialization.load_pem_private_key(path.read_bytes(), None)
    if not isinstance(loaded, Ed25519PrivateKey):
        raise ValueError(f"{path} holds no Ed25519 key; restore it from a backup")
    return Signer(loaded)


def verify_receipt(receipt: dict[str, Any], public_key: str) -> dict[str, Any]:
    """Return the content of a receipt that this key signed.

    Raises:
        ValueError: The receipt is not of the form, or the key did not sign this content.
    """
    try:
        content, signature = receipt["content"], base64.b64decode(receipt["signature"])
        key = Ed25519PublicKey.from_public_bytes(base64.b64decode(public_key))
        key.verify(signature, canonical_json(content))
    except InvalidSignature:
        raise ValueError(
            "the receipt was not signed by this key, or was changed after it was signed"
        ) from None
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"this is not a receipt, or not a key ({error}); give the JSON that the server sent "
            "and the key of GET /api/about"
        ) from None
    return content
