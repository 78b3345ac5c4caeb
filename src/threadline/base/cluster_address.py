"""The address of a scheduler: on this computer, or by TLS, because it runs whatever it is sent."""

from __future__ import annotations

import ipaddress

from threadline.errors import OptionError


def parse_cluster(text: str) -> str:
    """Return the address of a scheduler: on this computer, or by TLS.

    >>> parse_cluster("localhost:8786"), parse_cluster("tls://lab.example:8786")
    ('tcp://localhost:8786', 'tls://lab.example:8786')

    Raises
    ------
    OptionError
        If it is no address, or an address of another computer without TLS.
    """
    way, _, rest = text.strip().rpartition("://")
    way = way or "tcp"
    host, _, port = rest.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    number = int(port[:9]) if port.isascii() and port.isdigit() else 0
    if way not in {"tcp", "tls"} or not host or not 1 <= number <= 65535:
        raise OptionError(
            f"--cluster {text[:80]!r} is no address of a scheduler",
            remedy='Write it like "localhost:8786", or "tls://HOST:8786" for another computer.',
        )
    if way == "tcp" and not _on_this_computer(host):
        raise OptionError(
            f"--cluster {text[:80]!r} is another computer, without encryption: a scheduler runs "
            "whatever it is sent",
            remedy=f'Start the scheduler with TLS, and write "tls://{rest}".',
        )
    return f"{way}://{rest}"


def _on_this_computer(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
