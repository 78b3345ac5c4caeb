"""Addresses as typed: checked before anything is looked up or connected."""

from __future__ import annotations

import pytest

from threadline.errors import OptionError
from threadline.live.port import bare, check_address, host_and_port, in_url, is_host


@pytest.mark.parametrize(
    "text",
    ["127.0.0.1", "localhost", "::1", "fe80::1%eth0", "winder-2.shop.example.", "a_b", "127.1",
     "münchen.example", "203.0.113.7", "7up.example"],
)  # fmt: skip
def test_hosts(text: str) -> None:
    assert is_host(text)


@pytest.mark.parametrize(
    "text",
    ["", " ", "a b", "a..b", ".a", "a/b", "a:b", "1.2.3.256", "1.2.3.4.5", "x" * 64, "a.\0",
     "[::1]", ".".join(["x" * 60] * 5), "::g"],
)  # fmt: skip
def test_malformed_host_names_are_recognised(text: str) -> None:
    assert not is_host(text)


def test_brackets_of_ipv6() -> None:
    assert in_url("::1") == "[::1]"
    assert in_url("127.0.0.1") == "127.0.0.1"
    assert bare("[::1]") == "::1"
    assert bare("[a]") == "[a]"


def test_addresses_of_a_controller() -> None:
    assert host_and_port("192.168.0.10:23") == ("192.168.0.10", 23)
    assert host_and_port("[::1]:65535") == ("::1", 65535)
    check_address("/dev/ttyUSB0")


@pytest.mark.parametrize(
    ("address", "says"),
    [
        ("localhost:99999", "port 99999 is not between 1 and 65535"),
        ("localhost:0", "port 0 is not between 1 and 65535"),
        ("localhost:\u00b2", "'\u00b2' is not a port"),
        ("localhost:", "'' is not a port"),
        ("localhost:-1", "'-1' is not a port"),
        ("localhost:" + "9" * 5000, "is not a port"),
        ("a..b:23", "'a..b' is not a host"),
        ("23", "there is no colon between host and port"),
        (":23", "'' is not a host"),
        ("dev/ttyUSB0", "there is no colon between host and port"),
    ],
)
def test_malformed_controller_address_is_refused(address: str, says: str) -> None:
    with pytest.raises(OptionError, match="is not an address of a controller") as refused:
        check_address(address)
    assert says in str(refused.value)
