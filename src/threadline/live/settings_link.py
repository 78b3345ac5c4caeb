"""Read the settings of a controller from the controller itself.

The queries move and change nothing: ``$I`` and ``$$`` for grbl and grblHAL, ``$CD`` for FluidNC,
``M115`` and ``M503`` for Marlin and RepRapFirmware; for Klipper, the configuration that Moonraker
returns over HTTP.

Sources: "Grbl v1.1 Commands" of gnea/grbl (``$$`` is answered only in Idle and Alarm); FluidNC,
``ProcessSettings.cpp`` (``$CD`` is ``Config/Dump``); marlinfw.org/docs/gcode, M115 and M503;
docs.duet3d.com, "Gcode dictionary", M115 and M503 (lists the lines of ``config.g``); Klipper,
"Status reference", ``configfile.config``; Moonraker, "Printer Administration",
``/printer/objects/query``.
"""

from __future__ import annotations

import json
import re
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from threadline.errors import LinkFaultError, OptionError
from threadline.live.guards import clock_s
from threadline.live.port import BAUD, Port, bare, host_and_port, is_host

KLIPPER = "klipper"
_BAUDS = (BAUD, 250_000)
"""Tried speeds of a serial device: Arduino boards with Marlin often use the second."""
STARTS_S = 3.0  # an Arduino restarts when its serial line is opened
_ANSWERS_S = 5.0
SILENCE_S = 0.5  # after an answer
_MOST_LINES, _MOST_BYTES = 20_000, 8_000_000
_FIRMWARE = re.compile(r"FIRMWARE_NAME:\s*([A-Za-z]+)")
_QUERY = "/printer/objects/query?configfile=config"
_BANNER, _STATUS, _NEVER = re.compile("Grbl "), re.compile("<"), re.compile(r"(?!)")
_OK = re.compile(r"\s*ok(?:\s|$)")
_ERROR = re.compile(r"\s*(?:error|Error|ALARM|!!)")
_END = re.compile(rf"{_OK.pattern}|{_ERROR.pattern}|.*Unknown command")
_REPORT = re.compile(r"\s*(?:<|echo:\s*busy|ok?\s*T:|T:|\[MSG)")  # unrequested reports
_MOVES = re.compile(r"<(Run|Jog|Home|Hold|Door)\b")


@dataclass(frozen=True, slots=True)
class ControllerSettings:
    """Settings of a controller, as it wrote them.

    Parameters
    ----------
    kind
        ``grbl``, ``fluidnc``, ``marlin``, ``rrf`` or ``klipper``.
    identity
        Version of the firmware, such as ``[VER:1.1h.20190830:]``.
    text
        Settings, line by line, as ``threadline new --from`` reads them.
    """

    kind: str
    identity: str
    text: str


def ask_controller(address: str, baud: int | None = None) -> ControllerSettings:
    """Return the identity and the settings of the controller at ``address``.

    Parameters
    ----------
    address
        Path of a serial device, ``HOST:PORT`` of a controller on the network, or the URL of a
        Moonraker (``http://HOST:7125``) for Klipper.
    baud
        Speed of the serial device in bits a second; None tries the two usual ones.

    Raises
    ------
    LinkFaultError
        If nothing answers, or the controller is busy or does not return its settings.
    OptionError
        If ``address`` is invalid, or settings of such a controller cannot be read.
    """
    if "://" in address:
        return _of_moonraker(address)
    address = address.removeprefix("grbl:")  # as the links of a run are written
    serial = address.startswith("/")
    if not serial:
        try:
            host_and_port(address)
        except OptionError as error:
            raise OptionError(
                error.message,
                remedy='Write it like "/dev/ttyUSB0", "192.168.0.10:23" or '
                '"http://192.168.0.10:7125".',
            ) from error
        if baud is not None:
            raise OptionError(
                f"{address[:60]!r} is on the network, where --baud has no meaning",
                remedy="Leave --baud out.",
            )
    heard: list[str] = []
    for speed in (baud,) if baud is not None else _BAUDS if serial else (BAUD,):
        port = Port(address, speed)
        try:
            settings = _asked(port, heard)
        finally:
            port.close()
        if settings is not None:
            return settings
    banner_line = next((line for line in heard if line.isprintable()), "")
    banner = f", which says {banner_line[:60]!r}," if banner_line else ""
    speeds = "" if not serial or baud is not None else " Say its speed with --baud."
    raise LinkFaultError(
        f"the controller at {address[:60]!r}{banner} does not name its firmware in its answers to "
        "$I and M115",
        remedy=f"Close other programs that talk to it, and look at its cable and power.{speeds}",
    )


def _asked(port: Port, heard: list[str]) -> ControllerSettings | None:
    """Return the settings of the controller at a port; None if it does not identify itself."""
    heard += _lines_until(port, STARTS_S, _BANNER)
    port.send(b"?")  # grbl answers at once; others take it as the start of an invalid line
    for line in _lines_until(port, SILENCE_S, _STATUS):
        if (match := _MOVES.match(line)) is not None:
            raise LinkFaultError(
                f"the controller is in the state {match[1]}: it lists its settings only at rest",
                remedy="Wait until it stands, and ask again.",
            )
    port.send(b"\n")  # ends what "?" began; grbl answers an empty line with ok, too
    _lines_until(port, SILENCE_S, _NEVER)
    port.send(b"$I\n")
    lines = [line.strip() for line in _answer(port)]
    version = next((line for line in lines if line.startswith("[VER:")), "")
    if version:
        if "fluidnc" in version.lower():
            return _settings(port, "fluidnc", version, b"$CD\n", [])
        about_lines = [line for line in lines if line.startswith("[")]
        return _settings(port, "grbl", version, b"$$\n", about_lines)
    heard += lines
    port.send(b"M115\n")
    heard += (lines := _answer(port))
    firmware = next((match for line in lines if (match := _FIRMWARE.search(line))), None)
    if firmware is None:
        return None
    identity = firmware.string.strip()[:120]
    name = firmware[1].lower()
    if name == "marlin":
        return _settings(port, "marlin", identity, b"M503\n", [identity])  # it tells the version
    if name == "reprapfirmware":
        return _settings(port, "rrf", identity, b"M503\n", [])
    if name == KLIPPER:
        raise OptionError(
            "Klipper does not tell its settings over this line",
            remedy="Name its printer.cfg with threadline new klipper DIR --from printer.cfg, or "
            "ask its Moonraker: threadline connect http://HOST:7125.",
        )
    raise OptionError(
        f"the controller says {identity!r}, a firmware whose planner is not known here",
        remedy="Write the machine file by hand: docs/machines.md says how.",
    )


def _settings(
    port: Port, kind: str, identity: str, question: bytes, about: list[str]
) -> ControllerSettings:
    """Ask for the settings; return them, preceded by the lines ``about`` the controller."""
    port.send(question)
    lines = [line for line in _answer(port) if not _REPORT.match(line)]
    error_line = next((line for line in lines if _ERROR.match(line)), "")
    if error_line or not lines or _OK.match(lines[-1]) is None:
        why = f"answered {error_line[:60]!r}" if error_line else "did not end its answer with ok"
        raise LinkFaultError(
            f"{identity[:60]!r} {why} when it was asked {question.decode().strip()}",
            remedy="Wait until the machine stands and no other program talks to it; ask again.",
        )
    return ControllerSettings(kind, identity, "\n".join([*about, *lines[:-1]]) + "\n")


def _answer(port: Port) -> list[str]:
    """Return the lines up to the first ``ok`` or error; discard later lines.

    Firmwares answer unknown lines, too, and a late ``ok`` must not end the next answer.
    """
    lines = _lines_until(port, _ANSWERS_S, _END)
    _lines_until(port, SILENCE_S, _NEVER)
    return lines


def _lines_until(port: Port, silence_s: float, last_pattern: re.Pattern[str]) -> list[str]:
    """Return lines up to one that matches ``last_pattern``, or until ``silence_s`` of silence.

    It ends after ten times ``silence_s`` in any case: a controller may send reports for ever.
    """
    lines: list[str] = []
    until_s = clock_s() + 10.0 * silence_s
    while len(lines) < _MOST_LINES and clock_s() < until_s:
        line = port.receive_indented(silence_s)
        if line is None:
            break
        lines.append(line)
        if last_pattern.match(line) is not None:
            break
    return lines


def _of_moonraker(address: str) -> ControllerSettings:
    """Return the configuration of the Klipper behind a Moonraker."""
    parts = urllib.parse.urlsplit(address)
    if parts.scheme not in ("http", "https") or not is_host(bare(parts.hostname or "")):
        raise OptionError(
            f"{address[:60]!r} is no address of a Moonraker",
            remedy='Write it like "http://192.168.0.10:7125".',
        )
    try:
        with urllib.request.urlopen(  # noqa: S310 - the scheme was checked
            f"{parts.scheme}://{parts.netloc}{_QUERY}", timeout=_ANSWERS_S
        ) as response:
            content = json.loads(response.read(_MOST_BYTES))
        sections = content["result"]["status"]["configfile"]["config"]
        if not isinstance(sections, dict) or not sections:
            raise KeyError("config")
    except urllib.error.HTTPError as error:
        is_untrusted = error.code in (401, 403)
        raise LinkFaultError(
            f"{address[:60]!r} refused to tell the configuration: HTTP {error.code}",
            remedy="Add this computer to trusted_clients in moonraker.conf."
            if is_untrusted
            else "Look whether it is a Moonraker, and whether Klipper is ready.",
        ) from error
    except OSError as error:
        reason = getattr(error, "reason", error)
        raise LinkFaultError(
            f"nothing answers at {address[:60]!r}: {getattr(reason, 'strerror', None) or reason}",
            remedy="Look whether Moonraker runs there; its port is 7125 unless it was changed.",
        ) from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise LinkFaultError(
            f"what answers at {address[:60]!r} does not tell a configuration of Klipper",
            remedy="Look whether it is a Moonraker, and whether Klipper is ready.",
        ) from error
    return ControllerSettings(KLIPPER, f"Klipper behind {parts.netloc}", _as_printer_cfg(sections))


def _as_printer_cfg(sections: Mapping[str, Any]) -> str:
    """Return sections and their raw values as the text of a ``printer.cfg``."""
    lines = []
    for name, values in sections.items():
        lines.append(f"[{name}]")
        for key, value in values.items() if isinstance(values, dict) else ():
            text = "\n    ".join(str(value).splitlines())
            lines.append(f"{key}: {text}")
        lines.append("")
    return "\n".join(lines)
