"""A proof as a file: hashes of all that it was made from, and its verdict.

Two proofs are of the same thing when their hashes agree. ``docs/files.md`` says what each hash is
of, so that another program can compare them; an executor asks ``check_proof`` before it moves.

A hash shows that nothing was changed since it was written, and not who wrote it. A proof may be
signed with a key, HMAC-SHA256: who has the same key sees that the proof is of somebody who has it.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from errno import ENOENT
from pathlib import Path
from typing import Any

from threadline import __version__
from threadline.base.reading import read_text
from threadline.commands.plan import Plan
from threadline.errors import OptionError, Place, ProofError
from threadline.files.formats.common import Written, atomic_file, written
from threadline.machine import Machine, load_machine
from threadline.machine.load import split_reference
from threadline.machine.par import read_parameters
from threadline.proof.options import options_from
from threadline.proof.pipeline import Proof, open_job, plan_job, with_shaping
from threadline.proof.proof_form import contradiction, in_spec, misformed, unlike
from threadline.verdict import Spec, load_spec
from threadline.verdict.rendering import criteria_json

FORMAT = "threadline proof 1"
_MAX_BYTES = 64 << 20
_NAMES = ("job", "machine", "par")
"""Options that name files: the proof has the hashes of the files instead."""
_PARTS = ("job", "machine", "actual", "options", "spec", "commands")
_METHOD = "HMAC-SHA256"
_LEAST_KEY, _MOST_KEY = 16, 1 << 16  # bytes
_PLACES = {
    "job": ("file",), "spec": ("file",), "machine": ("reference", "par"),
    "actual": ("reference", "par"),
}  # fmt: skip
"""Entries that say where a file is: its hash says what is in it."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Something that is not what it was when the proof was made.

    Parameters
    ----------
    what
        ``"job"``, ``"machine"``, ``"actual"``, ``"options"``, ``"spec"``, ``"commands"`` or
        ``"threadline"``.
    name
        Which one it is, as the proof names it.
    proved, found
        The hash (or version) that the proof has, and the one that is there now.
    """

    what: str
    name: str
    proved: str
    found: str

    def __str__(self) -> str:
        if self.what == "threadline":
            return f"threadline is version {self.found}, the proof is by {self.proved}"
        return (
            f"{self.what} {self.name!r} has the sha256 {self.found[:12] or 'none'}, the proof has "
            f"{self.proved[:12] or 'none'}"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProofFile:
    """A proof as it was read.

    Parameters
    ----------
    path
        The file; the names of other files in it count from its folder.
    content
        All that it says, as in ``docs/files.md``.
    """

    path: Path
    content: Mapping[str, Any]

    @property
    def passed(self) -> bool:
        """Whether its criteria come to a verdict in specification."""
        return in_spec(self.content)

    @property
    def level(self) -> str:
        """How far the verdict reaches: ``"nominal"``, ``"repeated"``, ``"over tolerances"``, ..."""
        return str(self.content["level"])

    @property
    def signed(self) -> bool:
        """Whether it has a signature, of whatever key."""
        return "signature" in self.content

    @property
    def spec_path(self) -> Path | None:
        """The file of the specification; None where it is the machine's own."""
        file = self.content["spec"]["file"]
        return None if file is None else self.path.parent / file

    def sha256(self, what: str) -> str:
        """Return the hash of one of its parts; empty where there is no such part."""
        part = self.content[what]
        return "" if part is None else str(part["sha256"])

    def name(self, what: str) -> str:
        """Return how one of its parts is called."""
        part = self.content[what] or {}
        return str(part.get("name", part.get("kind", what)))


def proof_content(proof: Proof, folder: Path, key: bytes | None = None) -> dict[str, Any]:
    """Return what the file of a proof in ``folder`` says, signed by a key if there is one.

    Reads the commands once.
    """
    plan = proof.plan
    given = {key: value for key, value in plan.options.items() if key not in _NAMES}
    content = {
        "format": FORMAT,
        "threadline": __version__,
        "level": proof.verdict.level.value,
        "runs": proof.runs,
        "machines": proof.verdict.machines,
        "job": {
            "name": plan.job.name,
            "file": _beside(plan.job.file, folder),
            "sha256": plan.job.sha256,
        },
        "machine": _machine(plan.machine, folder),
        "actual": None if proof.actual is None else _machine(proof.actual, folder),
        "options": {"given": given, "sha256": _canonical_sha256(given)},
        "spec": {
            "name": proof.spec.name,
            "file": _beside(proof.spec.file, folder) if proof.spec.file else None,
            "sha256": spec_sha256(proof.spec),
        },
        "commands": {
            "kind": plan.machine.commanded_by,
            "sha256": plan.commands.rows_sha256(),
        },
        "verdict": {
            "passed": proof.verdict.passed,
            "simulated": proof.verdict.simulated,
            "incomplete": proof.verdict.incomplete,
            "criteria": criteria_json(proof.verdict),
        },
    }
    if key is not None:
        content["signature"] = {"method": _METHOD, "value": _signature(content, key)}
    return {**content, "sha256": _canonical_sha256(content)}


def write_proof(proof: Proof, path: str | Path, key: bytes | None = None) -> Written:
    """Write a proof as a file; equal proofs give equal bytes.

    Parameters
    ----------
    key
        What it is signed with, as ``read_key`` returns it; None leaves it unsigned.

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    path = Path(path)
    return _write(proof_content(proof, path.parent, key), path)


def read_key(path: str | Path) -> bytes:
    """Return the key in a file: all of its bytes, but for ends of lines behind them.

    Raises
    ------
    OptionError
        If it cannot be read, or is shorter than 16 bytes or longer than 65 536.
    """
    path = Path(path)
    try:
        # Not by a reader that notes the inputs of a run, which are copied beside it.
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


def _check_signature(proof: ProofFile, key: bytes) -> None:
    """Refuse a proof that was not signed with a key, or was changed since."""
    place = Place(str(proof.path))
    if not proof.signed:
        raise ProofError(
            "it is not signed",
            place=place,
            remedy="Sign it as it is made: threadline prove JOB --proof FILE --sign KEY.",
        )
    told = proof.content["signature"]
    value = told.get("value") if isinstance(told, dict) else None
    known = isinstance(value, str) and told.get("method") == _METHOD
    if not known or not hmac.compare_digest(
        str(value).encode(), _signature(proof.content, key).encode()
    ):
        raise ProofError(
            "its signature is not of this key, or it was changed since it was signed",
            place=place,
            remedy="Give the key that it was signed with, or prove the job again.",
        )


def _signature(content: Mapping[str, Any], key: bytes) -> str:
    """Return the signature of a proof, which is the same wherever its files lie."""
    signed = {k: v for k, v in content.items() if k not in {"sha256", "signature"}}
    for what, places in _PLACES.items():
        if signed[what] is not None:
            signed[what] = {k: v for k, v in signed[what].items() if k not in places}
    return hmac.new(key, _canonical(signed), hashlib.sha256).hexdigest()


def copy_proof(known: ProofFile, path: str | Path) -> ProofFile:
    """Write a proof to another folder, where its names lead to the same files, and return that.

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    path = Path(path)
    here, there = known.path.parent, path.parent
    content = {key: value for key, value in known.content.items() if key != "sha256"}
    for what in ("job", "spec"):
        if (file := content[what]["file"]) is not None:
            content[what] = {**content[what], "file": _from(here, file, there)}
    for what in ("machine", "actual"):
        if (told := content[what]) is None:
            continue
        name, overlays = split_reference(str(told["reference"]))
        if name.endswith(".toml"):
            name = _from(here, name, there)
        par = None if told["par"] is None else _from(here, told["par"], there)
        content[what] = {**told, "reference": "+".join([name, *overlays]), "par": par}
    content = {**content, "sha256": _canonical_sha256(content)}
    _write(content, path)
    return ProofFile(path=path, content=content)


def read_proof(path: str | Path, key: bytes | None = None) -> ProofFile:
    """Read the file of a proof.

    Parameters
    ----------
    path
        The file.
    key
        What it has to be signed with, as ``read_key`` returns it; None asks for no signature.

    Raises
    ------
    ProofError
        If it is none, was changed since it was written, contradicts itself, or was not signed with
        the key.
    """
    path = Path(path)
    place = Place(str(path))
    text = read_text(path, _MAX_BYTES, ProofError, "proof")
    try:
        content = json.loads(text, parse_constant=_refuse_constant)
        _canonical_sha256(content)  # which numbers without end and half characters have none of
    except (ValueError, RecursionError) as error:
        raise ProofError("the file is no JSON", place=place, remedy="Give a proof.") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ProofError(
            f"the file does not say that it is a {FORMAT!r}",
            place=place,
            remedy="Write one with threadline prove --proof FILE.",
        )
    rest = {key: value for key, value in content.items() if key != "sha256"}
    if content.get("sha256") != _canonical_sha256(rest):
        raise ProofError(
            "the file was changed since it was written: it does not have the sha256 that it says",
            place=place,
            remedy="Prove the job again.",
        )
    if where := misformed(content):
        raise ProofError(
            f"{where!r} is not there, or is not what a proof has there",
            place=place,
            remedy="Write one with threadline prove --proof FILE.",
        )
    if why := contradiction(content) or _other_options(content):
        raise _contradicts(path, why)
    found = ProofFile(path=path, content=content)
    if key is not None:
        _check_signature(found, key)
    return found


def _contradicts(path: Path, why: str) -> ProofError:
    return ProofError(
        f"it contradicts itself: {why}", place=Place(str(path)), remedy="Prove the job again."
    )


def _other_options(content: Mapping[str, Any]) -> str:
    told = content["options"]
    right = told["sha256"] == _canonical_sha256(told["given"])
    return "" if right else "the sha256 of its options is not the one of the options in it"


def check_proof(
    proof: ProofFile | str | Path, plan: Plan, spec: Spec, actual: Machine | None = None
) -> tuple[Difference, ...]:
    """Return what differs between a proof and what is about to be done; empty when nothing does.

    Parameters
    ----------
    proof
        The proof, or its file.
    plan
        What is about to be done; its commands are read once.
    spec
        What it is asked to keep.
    actual
        The machine that runs the plan, where it isn't the one that it was made for.

    Raises
    ------
    ProofError
        If the file is no proof, or its criteria are not those of the specification that it has the
        hash of.
    """
    known = proof if isinstance(proof, ProofFile) else read_proof(proof)
    given = {key: value for key, value in plan.options.items() if key not in _NAMES}
    found = {
        "job": plan.job.sha256,
        "machine": plan.machine.sha256,
        "actual": "" if actual is None else actual.sha256,
        "options": _canonical_sha256(given),
        "spec": spec_sha256(spec),
        "commands": plan.commands.rows_sha256(),
    }
    differences = [
        Difference(what, known.name(what), known.sha256(what), found[what])
        for what in _PARTS
        if known.sha256(what) != found[what]
    ]
    if known.content["threadline"] != __version__:
        told = str(known.content["threadline"])
        differences.append(Difference("threadline", "threadline", told, __version__))
    if not differences and (why := unlike(known.content, plan, spec)):
        raise _contradicts(known.path, why)
    return tuple(differences)


def verify_proof(proof: ProofFile | str | Path) -> tuple[Difference, ...]:
    """Plan again from the files that a proof names, and return what differs from it.

    Raises
    ------
    ProofError
        If the file is no proof.
    InputError
        If one of the files that it names cannot be read, or the job cannot be planned any more.
    """
    known = proof if isinstance(proof, ProofFile) else read_proof(proof)
    folder = known.path.parent
    content = known.content
    machine = _load(content["machine"], folder)
    actual = None if content["actual"] is None else _load(content["actual"], folder)
    options = options_from(content["options"]["given"])
    spec = load_spec(known.spec_path, machine)
    job = open_job(folder / content["job"]["file"], machine, options)
    early = _early(known, job.sha256, machine, actual)
    if early:
        # The plan of something else would only say again that it is something else.
        return early
    plan = plan_job(job, machine, options)
    return check_proof(known, plan, with_shaping(spec, machine, options), actual)


def spec_sha256(spec: Spec) -> str:
    """Return the hash of a specification in force: its name, lag and every criterion."""
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
    return _canonical_sha256(content)


def _early(
    known: ProofFile, job_sha256: str, machine: Machine, actual: Machine | None
) -> tuple[Difference, ...]:
    found = {
        "job": job_sha256,
        "machine": machine.sha256,
        "actual": "" if actual is None else actual.sha256,
    }
    return tuple(
        Difference(what, known.name(what), known.sha256(what), sha256)
        for what, sha256 in found.items()
        if known.sha256(what) != sha256
    )


def _machine(machine: Machine, folder: Path) -> dict[str, Any]:
    name, overlays = split_reference(machine.reference)
    if name.endswith(".toml"):
        name = _beside(name, folder)
    return {
        "name": machine.name,
        "reference": "+".join([name, *overlays]),
        "par": _beside(machine.parameters, folder) if machine.parameters else None,
        "sha256": machine.sha256,
    }


def _load(told: Mapping[str, Any], folder: Path) -> Machine:
    name, overlays = split_reference(str(told["reference"]))
    if name.endswith(".toml"):
        name = os.path.normpath(folder / name)
    machine = load_machine("+".join([name, *overlays]))
    return machine if told["par"] is None else read_parameters(folder / told["par"], machine)


def _from(here: Path, file: str, there: Path) -> str:
    """Return a path that counts from ``here`` as one that counts from ``there``."""
    return _beside(os.path.normpath(here / file), there)


def _write(content: Mapping[str, Any], path: Path) -> Written:
    with atomic_file(path) as file:
        text = json.dumps(content, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False)
        file.write(f"{text}\n".encode())
    return written(path)


def _beside(file: str, folder: Path) -> str:
    """Return the path of a file relative to ``folder``, or absolute if there is none."""
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:  # on another drive
        return Path(file).absolute().as_posix()


def _canonical(content: Any) -> bytes:
    """Return JSON with sorted keys and no blanks, in UTF-8."""
    text = json.dumps(
        content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return text.encode()


def _canonical_sha256(content: Any) -> str:
    """Return the SHA-256 of canonical JSON."""
    return hashlib.sha256(_canonical(content)).hexdigest()


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is no number")
