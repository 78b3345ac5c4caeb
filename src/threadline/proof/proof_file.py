"""The files of a proof: hashes of all its inputs with its verdict, and the worst machine found.

Two proofs have equal hashes if they prove the same thing. ``docs/files.md`` defines each hash, so
that another program can compare them. An executor calls ``check_proof`` before it moves a machine.

A hash shows that nothing was changed since the file was written, but not who wrote it. A proof may
be signed with a key (HMAC-SHA256): the signature shows that the writer had that key.
"""

from __future__ import annotations

import hmac
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from threadline import __version__
from threadline.base.reading import note_input, read_text
from threadline.commands.plan import Plan
from threadline.errors import Place, ProofError
from threadline.files.formats.common import Written, atomic_file, written
from threadline.machine import Machine, load_machine
from threadline.machine.load import split_reference
from threadline.machine.par import read_parameters
from threadline.proof import worst_machine
from threadline.proof.options import options_from
from threadline.proof.pipeline import Proof, open_job, plan_job, with_shaping
from threadline.proof.proof_form import contradiction, criteria_difference, in_spec, malformed_entry
from threadline.proof.proof_hash import METHOD, canonical_sha256, signature, spec_sha256
from threadline.verdict import Spec, load_spec
from threadline.verdict.rendering import criteria_json, tolerances_json

FORMAT = "threadline proof 1"
_MAX_BYTES = 64 << 20
_NAMES = ("job", "machine", "par")
"""Options that name files; a proof holds the hashes of these files instead."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A part of a proof that has changed since the proof was made.

    Parameters
    ----------
    what
        ``"job"``, ``"machine"``, ``"actual"``, ``"options"``, ``"spec"``, ``"commands"`` or
        ``"threadline"``.
    name
        Name of this part in the proof.
    proved, found
        The hash (or version) in the proof, and the present hash (or version).
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
    """A proof as read from its file.

    Parameters
    ----------
    path
        The file; file names in it are relative to its folder.
    content
        All its entries, as in ``docs/files.md``.
    """

    path: Path
    content: Mapping[str, Any]

    @property
    def passed(self) -> bool:
        """Whether its criteria give a passed verdict."""
        return in_spec(self.content)

    @property
    def level(self) -> str:
        """Level of the verdict: ``"nominal"``, ``"repeated"``, ``"over tolerances"``, ..."""
        return str(self.content["level"])

    @property
    def signed(self) -> bool:
        """Whether it has a signature, made with any key."""
        return "signature" in self.content

    @property
    def spec_path(self) -> Path | None:
        """The file of the specification; None for the specification of the machine."""
        file = self.content["spec"]["file"]
        return None if file is None else self.path.parent / file

    def sha256(self, what: str) -> str:
        """Return the hash of one of its parts; empty if there is no such part."""
        part = self.content[what]
        return "" if part is None else str(part["sha256"])

    def name(self, what: str) -> str:
        """Return the name of one of its parts."""
        part = self.content[what] or {}
        return str(part.get("name", part.get("kind", what)))


def proof_content(proof: Proof, folder: Path, key: bytes | None = None) -> dict[str, Any]:
    """Return the content of a proof file in ``folder``, signed if there is a key.

    Reads the commands once.
    """
    plan = proof.plan
    given = _given(plan)
    content = {
        "format": FORMAT,
        "threadline": __version__,
        "level": proof.verdict.level.value,
        "runs": proof.runs,
        "machines": proof.verdict.machines,
        **tolerances_json(proof.verdict),
        "job": {
            "name": plan.job.name,
            "file": _beside(plan.job.file, folder),
            "sha256": plan.job.sha256,
        },
        "machine": _machine(plan.machine, folder),
        "actual": None if proof.actual is None else _machine(proof.actual, folder),
        "options": {"given": given, "sha256": canonical_sha256(given)},
        "spec": {
            "name": proof.spec.name,
            "file": _beside(proof.spec.file, folder) if proof.spec.file else None,
            "sha256": spec_sha256(proof.spec),
        },
        "commands": {"kind": plan.machine.commanded_by, "sha256": plan.commands.rows_sha256()},
        "verdict": {
            "passed": proof.verdict.passed,
            "simulated": proof.verdict.simulated,
            "incomplete": proof.verdict.incomplete,
            "criteria": criteria_json(proof.verdict),
        },
    }
    if key is not None:
        content["signature"] = {"method": METHOD, "value": signature(content, key)}
    return {**content, "sha256": canonical_sha256(content)}


def write_proof(proof: Proof, path: str | Path, key: bytes | None = None) -> Written:
    """Write a proof as a file; equal proofs give files with equal bytes.

    Parameters
    ----------
    key
        Signing key, as from ``read_key``; None leaves the proof unsigned.

    Raises
    ------
    RecordingError
        If the file cannot be written.
    """
    path = Path(path)
    return _write(proof_content(proof, path.parent, key), path)


def _check_signature(proof: ProofFile, key: bytes) -> None:
    """Refuse a proof that was not signed with ``key``, or that was changed after signing."""
    place = Place(str(proof.path))
    if not proof.signed:
        raise ProofError(
            "it is not signed",
            place=place,
            remedy="Sign it as it is made: threadline prove JOB --proof FILE --sign KEY.",
        )
    stated = proof.content["signature"]
    value = stated.get("value") if isinstance(stated, dict) else None
    known = isinstance(value, str) and stated.get("method") == METHOD
    if not known or not hmac.compare_digest(
        str(value).encode(), signature(proof.content, key).encode()
    ):
        raise ProofError(
            "its signature is not by this key, or it was changed since it was signed",
            place=place,
            remedy="Give the key that it was signed with, or prove the job again.",
        )


def copy_proof(known: ProofFile, path: str | Path) -> ProofFile:
    """Write a proof into another folder, with its file names adapted, and return the copy.

    Raises
    ------
    RecordingError
        If it cannot be written.
    """
    path = Path(path)
    old_folder, new_folder = known.path.parent, path.parent
    content = {key: value for key, value in known.content.items() if key != "sha256"}
    for what in ("job", "spec"):
        if (file := content[what]["file"]) is not None:
            content[what] = {**content[what], "file": _relative_from(old_folder, file, new_folder)}
    for what in ("machine", "actual"):
        if (machine := content[what]) is None:
            continue
        name, overlays = split_reference(str(machine["reference"]))
        if name.endswith(".toml"):
            name = _relative_from(old_folder, name, new_folder)
        par = (
            None
            if machine["par"] is None
            else _relative_from(old_folder, machine["par"], new_folder)
        )
        content[what] = {**machine, "reference": "+".join([name, *overlays]), "par": par}
    content = {**content, "sha256": canonical_sha256(content)}
    _write(content, path)
    return ProofFile(path=path, content=content)


def read_proof(path: str | Path, key: bytes | None = None) -> ProofFile:
    """Read the file of a proof.

    Parameters
    ----------
    path
        The file.
    key
        Key that must have signed it, as from ``read_key``; None requires no signature.

    Raises
    ------
    ProofError
        If the file is not a proof, was changed since it was written, contradicts itself, or was not
        signed with the key.
    """
    path = Path(path)
    place = Place(str(path))
    text = read_text(path, _MAX_BYTES, ProofError, "proof")
    try:
        content = json.loads(
            text, parse_constant=_refuse_constant, object_pairs_hook=partial(_entries, place)
        )
        canonical_sha256(content)  # fails on infinite numbers and unpaired surrogates
    except ProofError:
        raise
    except (ValueError, RecursionError) as error:
        raise ProofError("the file is not JSON", place=place, remedy="Give a proof.") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ProofError(
            f"the file is not marked as a {FORMAT!r}",
            place=place,
            remedy="Write one with threadline prove --proof FILE.",
        )
    hashed_content = {key: value for key, value in content.items() if key != "sha256"}
    if content.get("sha256") != canonical_sha256(hashed_content):
        raise ProofError(
            "the file was changed since it was written: its sha256 entry does not match",
            place=place,
            remedy="Prove the job again.",
        )
    if entry_name := malformed_entry(content):
        raise ProofError(
            f"{entry_name!r} is missing, or has the wrong type",
            place=place,
            remedy="Write one with threadline prove --proof FILE.",
        )
    if reason := contradiction(content) or _other_options(content):
        raise _contradicts(path, reason)
    proof = ProofFile(path=path, content=content)
    if key is not None:
        _check_signature(proof, key)
    return proof


def _contradicts(path: Path, reason: str) -> ProofError:
    return ProofError(
        f"it contradicts itself: {reason}", place=Place(str(path)), remedy="Prove the job again."
    )


def _other_options(content: Mapping[str, Any]) -> str:
    options = content["options"]
    matches = options["sha256"] == canonical_sha256(options["given"])
    return "" if matches else "the sha256 of its options does not match the options in it"


def check_proof(
    proof: ProofFile | str | Path, plan: Plan, spec: Spec, actual: Machine | None = None
) -> tuple[Difference, ...]:
    """Return the differences between a proof and a plan to be run; empty if there are none.

    Parameters
    ----------
    proof
        The proof, or its file.
    plan
        The plan to be run; its commands are read once.
    spec
        The specification that the plan must meet.
    actual
        The machine that runs the plan, if it is not the planned one.

    Raises
    ------
    ProofError
        If the file is not a proof, or its criteria differ from the specification whose hash it has.
    """
    proof_file = proof if isinstance(proof, ProofFile) else read_proof(proof)
    hashes = {
        **_read_sha256(plan.job.sha256, plan.machine, actual),
        "options": options_sha256(plan),
        "spec": spec_sha256(spec),
        "commands": plan.commands.rows_sha256(),
    }
    differences = _differences(proof_file, hashes)
    if proof_file.content["threadline"] != __version__:
        version = str(proof_file.content["threadline"])
        differences.append(Difference("threadline", "threadline", version, __version__))
    if not differences and (reason := criteria_difference(proof_file.content, plan, spec)):
        raise _contradicts(proof_file.path, reason)
    return tuple(differences)


def verify_proof(proof: ProofFile | str | Path) -> tuple[Difference, ...]:
    """Plan again from the files that a proof names, and return the differences.

    Raises
    ------
    ProofError
        If the file is not a proof.
    InputError
        If one of the named files cannot be read, or the job can no longer be planned.
    """
    proof_file = proof if isinstance(proof, ProofFile) else read_proof(proof)
    folder = proof_file.path.parent
    content = proof_file.content
    machine = _load(content["machine"], folder)
    actual = None if content["actual"] is None else _load(content["actual"], folder)
    options = options_from(content["options"]["given"])
    spec = load_spec(proof_file.spec_path, machine)
    job = open_job(folder / content["job"]["file"], machine, options)
    file_differences = _differences(proof_file, _read_sha256(job.sha256, machine, actual))
    if file_differences:
        # A plan from other files would only report the same difference again.
        return tuple(file_differences)
    plan = plan_job(job, machine, options)
    return check_proof(proof_file, plan, with_shaping(spec, machine, options), actual)


def options_sha256(plan: Plan) -> str:
    """Return the hash of the planning options, as it stands in a proof."""
    return canonical_sha256(_given(plan))


def _given(plan: Plan) -> dict[str, Any]:
    return {key: value for key, value in plan.options.items() if key not in _NAMES}


def _read_sha256(job_sha256: str, machine: Machine, actual: Machine | None) -> dict[str, str]:
    """Return the hashes of the files that are read before a plan is made."""
    other = "" if actual is None else actual.sha256
    return {"job": job_sha256, "machine": machine.sha256, "actual": other}


def _differences(known: ProofFile, found: Mapping[str, str]) -> list[Difference]:
    return [
        Difference(what, known.name(what), known.sha256(what), sha256)
        for what, sha256 in found.items()
        if known.sha256(what) != sha256
    ]


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


def _load(content: Mapping[str, Any], folder: Path) -> Machine:
    name, overlays = split_reference(str(content["reference"]))
    if name.endswith(".toml"):
        name = os.path.normpath(folder / name)
    machine = load_machine("+".join([name, *overlays]))
    return machine if content["par"] is None else read_parameters(folder / content["par"], machine)


def _relative_from(old_folder: Path, file: str, new_folder: Path) -> str:
    """Return a path relative to ``old_folder`` as a path relative to ``new_folder``."""
    return _beside(os.path.normpath(old_folder / file), new_folder)


def _write(content: Mapping[str, Any], path: Path) -> Written:
    with atomic_file(path) as file:
        text = json.dumps(content, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False)
        file.write(f"{text}\n".encode())
    return written(path)


def _beside(file: str, folder: Path) -> str:
    """Return the path of a file relative to ``folder``, or absolute if that is impossible."""
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:  # on another drive
        return Path(file).absolute().as_posix()


def _entries(place: Place, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the entries of a JSON object; refuse two entries with the same name.

    Readers of JSON differ in which of the two entries they take.
    """
    entries = dict(pairs)
    if len(entries) < len(pairs):
        names = [name for name, _ in pairs]
        repeated = next(name for name in names if names.count(name) > 1)
        raise ProofError(
            f"the entry {repeated[:40]!r} occurs twice", place=place, remedy="Give a proof."
        )
    return entries


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is not a number")


def write_worst(proof: Proof, file: Path) -> None:
    """Write the machine file of the worst machine within the tolerances that a proof found.

    Raises
    ------
    OptionError, OSError
        If the file cannot be written, or is a machine file of the proof.
    """
    assert proof.worst is not None
    machine = proof.plan.machine if proof.actual is None else proof.actual
    for one in (proof.plan.machine, machine):
        note_input(Path(one.file))  # the written file would else become its own base
    worst_machine.write_worst(machine, proof.worst, file, "prove --tolerances")


def write_worst_beside(proof: Proof, report: Path) -> Path | None:
    """Write the worst machine of a proof into its report; return the file, None if none was found.

    Raises
    ------
    OptionError, OSError
        As for ``write_worst``.
    """
    if proof.worst is None:
        return None
    write_worst(proof, report / "worst.toml")
    return report / "worst.toml"
