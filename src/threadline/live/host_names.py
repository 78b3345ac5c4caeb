"""Names and addresses of hosts, as they are typed: whether one could be that of a computer."""

from __future__ import annotations

import re
import socket
from ipaddress import ip_address

_NAME = re.compile(r"[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*\.?")
_MOST = 253
MOST_PORT = 65535
"""Largest number of a TCP port."""


def is_host(text: str) -> bool:
    """Return whether a text is an IP address, or written as a name of a host is.

    A name has letters, digits, ``-`` and ``_`` in parts between dots (RFC 1123, and the underscore
    that is met in practice), 253 characters at most; one of other alphabets is taken by its form in
    ASCII (RFC 3490). What ends in digits alone has to be an address. No name is looked up.
    """
    try:
        ip_address(text)
    except ValueError:
        pass
    else:
        return True
    try:
        name = text.encode("idna").decode("ascii")
    except UnicodeError:
        return False
    if len(name) > _MOST or _NAME.fullmatch(name) is None:
        return False
    return not name.rstrip(".").rpartition(".")[2].isdecimal() or _is_old_address(name)


def bare(host: str) -> str:
    """Return a host without the brackets in which an address of IPv6 may stand."""
    return host[1:-1] if host.startswith("[") and host.endswith("]") and ":" in host else host


def in_url(host: str) -> str:
    """Return a host as it stands in a URL: an address of IPv6 in brackets (RFC 3986)."""
    return f"[{host}]" if ":" in host else host


def _is_old_address(name: str) -> bool:
    """Return whether it is an address with fewer than four numbers, as ``127.1``."""
    try:
        socket.inet_aton(name)
    except OSError:
        return False
    return True
