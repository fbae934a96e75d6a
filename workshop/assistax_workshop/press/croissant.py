"""Metadata of a remote in the Croissant format: what it holds, each file with its sha256."""

import json
from typing import Any

from assistax_base.digest import sha256
from zoo.registry import Registry

FILE = "croissant.json"
SPECIFICATION = "http://mlcommons.org/croissant/1.0"
# Of Croissant 1.0: what the words below stand for.
CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "sc": "https://schema.org/",
}


def croissant(registry: Registry, name: str, license: str, url: str = "") -> bytes:
    """Return the metadata of a remote; the same registry gives the same bytes.

    Args:
        registry: The published registry, whose file is in place.
        name: Name of the remote.
        license: Licence of the policies, as hubs name it.
        url: Address of the remote's page, if it has one.
    """
    release = registry.data.releases[registry.release]
    authors = release.citation.authors if release.citation else ()
    files = [_file("registry.json", "application/json", *_described(registry))]
    files += [
        _file(path, "application/octet-stream", shard.sha256, shard.bytes)
        for path, shard in sorted(registry.data.shards.items())
    ]
    content = {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": SPECIFICATION,
        "name": name.replace("/", "-"),
        "description": release.description
        or "Partners and robots of assistive tasks, for zero-shot coordination.",
        "license": f"https://spdx.org/licenses/{license}",
        "version": f"{registry.release.removeprefix('v')}.0.0",
        "datePublished": release.date,
        "citeAs": f"{name}, release {registry.release}, root {registry.root(registry.release)}",
        **({"url": url} if url else {}),
        **({"creator": [{"@type": "Person", "name": author} for author in authors]}),
        "distribution": files,
    }
    return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()


def _described(registry: Registry) -> tuple[str, int]:
    """Return sha256 and size of the registry's file."""
    content = registry.path.read_bytes()
    return sha256(content), len(content)


def _file(path: str, form: str, digest: str, size: int) -> dict[str, str]:
    return {
        "@type": "cr:FileObject",
        "@id": path,
        "name": path.rpartition("/")[2],
        "contentUrl": path,
        "encodingFormat": form,
        "contentSize": f"{size} B",
        "sha256": digest,
    }
