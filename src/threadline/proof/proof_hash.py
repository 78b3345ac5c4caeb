"""Hashes and signatures of proofs: canonical JSON, its SHA-256, and the key that signs it."""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Mapping
from errno import ENOENT
from pathlib import Path
from typing import Any

from threadline.errors import OptionError
from threadline.verdict import Spec

METHOD = "HMAC-SHA256"


_LEAST_KEY, _MOST_KEY = 16, 1 << 16  # bytes


_PLACES = {
    "job": ("file",), "spec": ("file",), "machine": ("reference", "par"),
    "actual": ("reference", "par"),
}  # fmt: skip
"""Entries that only locate a file; the hash of the file identifies its content."""


def read_key(path: str | Path) -> bytes:
    """Return the key in a file: all of its bytes, except line ends at the end.

    Raises
    ------
    OptionError
        If the file cannot be read, or the key is shorter than 16 bytes or longer than 65 536.
    """
    path = Path(path)
    try:
        # The usual reader would note the key as an input, and a run copies its inputs to its
        # folder.
        if not path.is_file():
            raise FileNotFoundError(ENOENT, "there is no such file")
        with path.open("rb") as file:
            key = file.read(_MOST_KEY + 3).rstrip(b"\r\n")
    except OSError as error:
        raise OptionError(
            f"the key {str(path)!r} cannot be read: {error.strerror or error}",
            remedy="Give the file of a key.",
        ) from error
    if not _LEAST_KEY <= len(key) <= _MOST_KEY:
        raise OptionError(
            f"the key {str(path)!r} has {len(key)} bytes, not {_LEAST_KEY} to {_MOST_KEY}",
            remedy=f"Make one: openssl rand -hex 32 > {path.name}",
        )
    return key


def signature(content: Mapping[str, Any], key: bytes) -> str:
    """Return the signature of a proof; the folders of its files do not affect it."""
    signed = {k: v for k, v in content.items() if k not in {"sha256", "signature"}}
    for what, places in _PLACES.items():
        if signed[what] is not None:
            signed[what] = {k: v for k, v in signed[what].items() if k not in places}
    return hmac.new(key, _canonical(signed), hashlib.sha256).hexdigest()


def spec_sha256(spec: Spec) -> str:
    """Return the hash of a specification: its name, lag and every criterion."""
    criteria = [
        [
            criterion.name,
            criterion.axis,
            criterion.step,
            None if criterion.limit is None else repr(float(criterion.limit)),
            criterion.required,
            criterion.hard,
            criterion.every_axis,
            {key: repr(float(value)) for key, value in criterion.options.items()},
        ]
        for criterion in spec.criteria
    ]
    content = {"name": spec.name, "lag_s": repr(float(spec.lag_s)), "criteria": criteria}
    return canonical_sha256(content)


def _canonical(content: Any) -> bytes:
    """Return JSON with sorted keys and no blanks, in UTF-8."""
    text = json.dumps(
        content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return text.encode()


def canonical_sha256(content: Any) -> str:
    """Return the SHA-256 of canonical JSON."""
    return hashlib.sha256(_canonical(content)).hexdigest()
