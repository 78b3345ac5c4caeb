"""The options of a verb as words, and the machine, plan and runs that follow from them.

The command line and ``import threadline as tl`` both pass their options as ``Words``, so that both
read, plan and judge a job in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import NoReturn

from threadline.base.arguments import check_argument
from threadline.base.option_defaults import MOST_REPEATS, UNSHAPED_WORD, USUAL
from threadline.base.reading import note_input
from threadline.base.wording import nearest
from threadline.errors import OptionError
from threadline.jobs import own_product
from threadline.machine import Machine, load_machine
from threadline.machine.radii import with_radii
from threadline.motion.path.interpolations import OPTIMAL
from threadline.proof.kinds import kind_of
from threadline.proof.option_form import Door, Group, Word
from threadline.proof.option_table import (
    PLANNERS,
    TABLE,
    list_argument,
    options_for,
    python_name,
)
from threadline.proof.option_words import parse_band, parse_ends, parse_yield
from threadline.proof.options import Options, options_of
from threadline.proof.pipeline import NOMINAL, REPEATED, TOLERANCES, Trials, target_of, yielding
from threadline.proof.python_arguments import LEVEL_FLAGS, types_taken
from threadline.proof.verbs_without import reason
from threadline.verdict import Spec, load_spec

_LEVELS = {"nominal": NOMINAL, "repeated": REPEATED, "over tolerances": TOLERANCES}


def chosen_machine(machine: str | Path | Machine, par: str | Path | None = None) -> Machine:
    """Return a machine of the library or of a file, with the settings of the file ``par`` if given.

    Raises
    ------
    MachineError
        If there is no machine with that name, or the file does not describe one.
    """
    loaded = machine if isinstance(machine, Machine) else load_machine(machine)
    note_input(Path(loaded.file))
    if par is None:
        return loaded
    from threadline.machine.par import read_parameters

    return read_parameters(Path(par), loaded)


@dataclass(frozen=True, slots=True)
class Words:
    """The options of one verb, as given.

    Parameters
    ----------
    verb
        Name of the verb in the table of options.
    values
        Value of every option of the verb, as given or by default.
    """

    verb: str
    values: Mapping[str, Word]

    @classmethod
    def of(cls, verb: str, door: Door, words: Mapping[str, Word]) -> Words:
        """Return the words of a verb; options left out get their defaults.

        Raises
        ------
        OptionError
            If a word is not an option of the verb, or its value has the wrong type.
        """
        texts = dict(words)
        if door is Door.PYTHON:
            for one in options_for(verb, door):
                if one.word not in words:
                    continue
                value = words[one.word]
                check_argument(one.word, value, types_taken(one, verb))
                if isinstance(value, Sequence) and not isinstance(value, str):
                    texts[one.word] = ", ".join(value)
        return cls(verb, known_words(verb, door, texts))

    def text(self, word: str) -> str | None:
        """Return the text of an option; None if it was not given."""
        value = self.values.get(word)
        return None if value is None else str(value)

    def flag(self, word: str) -> bool:
        """Return whether a flag was given."""
        return bool(self.values.get(word))

    def path(self, word: str) -> Path | None:
        """Return the file of an option; None if it was not given."""
        text = self.text(word)
        return None if text is None else Path(text)

    def files(self) -> tuple[Path | None, ...]:
        """Return the input files among the options: settings and specification."""
        return self.path("par"), self.path("spec")

    def machine(self, machine: str | Path | Machine) -> Machine:
        """Return the named machine, with the settings of ``par``."""
        return chosen_machine(machine, self.path("par"))

    def actual(self) -> Machine | None:
        """Return the machine that runs the plan; None if it is the planned one."""
        other = self.values.get("actual")
        if other is None:
            return None
        return self.machine(other if isinstance(other, Machine) else str(other))

    def spec(self, machine: Machine) -> Spec:
        """Return the given specification, else the machine's own."""
        given = self.values.get("spec")
        return given if isinstance(given, Spec) else load_spec(self.path("spec"), machine)

    def planning(self) -> dict[str, Word]:
        """Return the words of the planning options only."""
        known = {one.word for door in Door for one in options_for(self.verb, door, [Group.PLAN])}
        return {word: value for word, value in self.values.items() if word in known}

    def options(self, job: str | Path | None = None, **changed: Word) -> Options:
        """Return the planning options; ``changed`` replaces words.

        A ``job`` that is a winding is judged on its own product, unless the words name a product.

        Raises
        ------
        OptionError
            If a word cannot be read, or two words exclude each other.
        """
        given = {**self.planning(), **changed}
        if job is not None and "product" in given and given["product"] is None:
            given["product"] = own_product(job)
        return options_of(**given)

    def each_options(
        self,
        job: str | Path,
        interpolations: Sequence[str],
        feeds: Sequence[str],
        shapers: Sequence[str],
    ) -> list[Options]:
        """Return planning options of a job for each interpolation, feed and shaper.

        ``contour`` and the other options of ``optimal`` are left out of plans with another
        interpolation, ``robust`` of plans with another interpolation than the default, and ``mode``
        and ``damping`` of plans without a shaper.

        Raises
        ------
        OptionError
            If a word cannot be read, or there is no interpolation.
        """
        if not interpolations:
            raise OptionError("there is no interpolation to compare", remedy="Name one at least.")
        combinations = []
        as_given: tuple[str | None, ...] = (None,)
        unshaped = {None, UNSHAPED_WORD}
        for name, feed, shaper in product(interpolations, feeds or as_given, shapers or as_given):
            combination: dict[str, Word] = {"interpolation": name, "feed": feed, "shaper": shaper}
            if name != OPTIMAL and OPTIMAL in interpolations:
                combination |= dict.fromkeys(_OF_OPTIMAL)
            if name not in USUAL and not USUAL.isdisjoint(interpolations):
                combination["robust"] = None
            if shaper in unshaped and not unshaped.issuperset(shapers):
                combination |= {"mode": None, "damping": None}
            combinations.append(self.options(job, **combination))
        return combinations

    def trials(self, ends: str | None = None) -> Trials:
        """Return the runs that make up a verdict; ``ends`` replaces the given word ``ends``.

        Raises
        ------
        OptionError
            If the words ask for several levels, or a word cannot be read.
        """
        words = {name: self.values.get(name) for name in _OF_LEVEL}
        return trials_of(**{**words, **({} if ends is None else {"ends": ends})})

    @contextmanager
    def judging(self, tell: Callable[[str], None] | None = None) -> Iterator[None]:
        """Let the workers of ``cluster`` judge the machines of the block.

        Without ``cluster`` this computer judges them.

        Parameters
        ----------
        tell
            Called with a description of the cluster.

        Raises
        ------
        OptionError, LinkFaultError
            If these options judge no machines on a cluster, or the cluster cannot be used.
        """
        address = self.text("cluster")
        if address is None:
            yield
            return
        if self.verb not in _ALWAYS_MANY:
            trials = self.trials()
            if trials.wanted_yield is not None:
                raise OptionError(
                    "--cluster judges the machines of --tolerances; this computer judges the "
                    "machines of --yield",
                    remedy="Give --tolerances in place of --yield, or leave --cluster out.",
                )
            if not trials.machines:
                raise OptionError(
                    "--cluster judges machines within the tolerances, and this level has none",
                    remedy="Give --tolerances, or leave --cluster out.",
                )
        from threadline.base.cluster import on_cluster  # few searches use a cluster

        with on_cluster(address, tell or (lambda _: None)):
            yield

    def changed(self, **changed: Word) -> dict[str, Word]:
        """Return the planning words that differ from the defaults of ``prove``.

        ``changed`` replaces words before the comparison.
        """
        known = {one.word: one for one in options_for("prove", groups=[Group.PLAN])}
        words = {**self.planning(), **changed}
        return {
            word: value
            for word, value in words.items()
            if value is not None and word in known and value != known[word].default
        }

    def typed(self, verb: str = "prove", **changed: Word) -> dict[str, str | Path | None]:
        """Return the options, as typed, with which the command ``verb`` makes the same plan.

        Defaults of that verb and the options of the level are left out.
        """
        given = {**self.values, **changed}
        typed: dict[str, str | Path | None] = {}
        for one in options_for(verb, groups=(Group.INPUT, Group.PLAN)):
            value = given.get(one.word)
            if value is not None and value != one.default and value is not False:
                typed["-s" if one.name == "spec" else one.typed] = _typed(value)
        return typed


def known_words(verb: str, door: Door, words: Mapping[str, Word]) -> dict[str, Word]:
    """Return the words of all options of a verb: given values, else defaults.

    Raises
    ------
    OptionError
        If a word is not an option of the verb, or its value is not one of the choices.
    """
    taken = {one.word: one for one in options_for(verb, door)}
    for word, value in words.items():
        if word not in taken:
            if door is Door.PYTHON:
                _refuse_argument(verb, word)
            raise OptionError(f"unknown option {word!r}", remedy=nearest(word, tuple(taken)))
        choices = taken[word].choices
        if choices and value not in choices:
            raise OptionError(f"unknown {word} {value!r}", remedy=nearest(str(value), choices))
    return {word: words.get(word, one.default_of(verb)) for word, one in taken.items()}


def _refuse_argument(verb: str, word: str) -> NoReturn:
    """Refuse an argument that the Python function of a verb does not take.

    Raises
    ------
    OptionError
        Names the right argument, the functions that take this one, or the most similar arguments.
    """
    lists = {one.word: name for one in TABLE if (name := list_argument(one, verb))}
    taken = [one.word for one in options_for(verb, Door.PYTHON)]
    instead = lists.get(word)
    if instead is None and "level" in taken and word in LEVEL_FLAGS:
        instead = LEVEL_FLAGS[word]
    if instead is not None:
        raise OptionError(f"{python_name(verb)} takes no {word}", remedy=f"Did you mean {instead}?")
    entry = _BY_WORD.get(word)
    why = None
    if entry is not None and Door.PYTHON in entry.doors:
        why = reason(entry.name, verb)
    if why is not None:
        # The decorator of the functions replaces options in the text by arguments.
        raise OptionError(f"{python_name(verb)} takes no {word}: {why.why}", remedy=why.instead)
    raise OptionError(f"unknown option {word!r}", remedy=nearest(word, [*lists.values(), *taken]))


_BY_WORD = {one.word: one for one in TABLE}


def line_refusal(command: str, typed: str) -> OptionError | None:
    """Return the refusal of an option of the table by a command that does not take it.

    Parameters
    ----------
    command, typed
        Name of the command, and the option as typed; None if the table does not have the option.
    """
    entry = next((one for one in TABLE if one.typed == typed), None)
    if entry is None:
        return None
    why = reason(entry.name, command)
    if why is not None:
        return OptionError(f"{command} takes no {typed}: {why.why}", remedy=why.instead)
    if command in entry.verbs and Door.LINE not in entry.doors:
        return OptionError(
            f"{typed} is an argument of Python",
            remedy="Give --nominal, or --tolerances; without them the level is repeated.",
        )
    if command in PLANNERS:
        return None
    verbs = [verb for verb in entry.verbs if verb != "panel"]
    return OptionError(
        f"{command} takes no {typed}; {', '.join(verbs)} take{'s' * (len(verbs) == 1)} it",
        remedy="Leave it out.",
    )


_OF_OPTIMAL = ("contour", "outside", "reserve", "narrow")
_ALWAYS_MANY = ("yield", "design")  # they judge machines at every level
_OF_LEVEL = ("level", "nominal", "repeats", "tolerances", "yield_", "ends", "band")


def _typed(value: Word) -> str | Path:
    if value is True:
        return ""
    return value if isinstance(value, Path) else str(value)


def trials_of(
    *,
    level: Word = None,
    nominal: Word = None,
    repeats: Word = None,
    tolerances: Word = None,
    yield_: Word = None,
    ends: Word = None,
    band: Word = None,
) -> Trials:
    """Return the trials that the words ask for: the numbers of runs and of machines.

    Raises
    ------
    OptionError
        If the words ask for several levels, or the wanted yield is not a share.
    """
    given = {
        "--nominal": bool(nominal),
        "--repeats": repeats is not None,
        "--tolerances": bool(tolerances),
        "--yield": yield_ is not None,
    }
    levels = [name for name, value in given.items() if value]
    if len(levels) > 1:
        raise OptionError(
            f"{' and '.join(levels)} ask for different levels", remedy="Give one of them."
        )
    trials = NOMINAL if nominal else TOLERANCES if tolerances else _LEVELS[str(level or "repeated")]
    if yield_ is not None:
        trials = yielding(parse_yield(str(yield_)))
    elif repeats is not None:
        trials = Trials(repeats=_runs(repeats), machines=trials.machines)
    return replace(
        trials,
        ends=None if ends is None else parse_ends(str(ends)),
        band=None if band is None else parse_band(str(band)),
    )


def _runs(repeats: Word) -> int:
    if not isinstance(repeats, int) or repeats < 1:
        raise OptionError(f"repeats must be at least 1, got {_short(repeats)}")
    if repeats > MOST_REPEATS:
        raise OptionError(f"repeats must be at most {MOST_REPEATS}, got {_short(repeats)}")
    return repeats


def _short(number: Word) -> str:
    many = isinstance(number, int) and abs(number) >= 10**12
    return "a number of many digits" if many else str(number)


def with_radii_of(machine: Machine, options: Options) -> Machine:
    """Return the machine with the radii of the options.

    Raises
    ------
    OptionError
        If an option has no meaning for this kind of machine, or the radii cannot be read.
    """
    kind_of(machine).check_options(machine, options)
    return with_radii(machine, options.radius)


def check_target(target: str, machine: Machine, options: Options) -> None:
    """Refuse a target that cannot write the plan, before anything is planned.

    Raises
    ------
    OptionError
        If the target is unknown or belongs to another kind of machine, if an option has no meaning
        for this kind, or if the plan needs a reference at every tick that the target cannot write.
    """
    kind = kind_of(machine)
    kind.check_options(machine, options)
    written_as = target_of(target, machine)
    feed_forward = options.feed_forward_s is not None
    if (feed_forward or options.shaper is not None) and not written_as.takes_shaped:
        targets = kind.targets
        raise OptionError(
            f"{'feed-forward' if feed_forward else 'a shaper'} gives a reference for every tick, "
            f"and target {target!r} cannot write it",
            remedy=f"Use {' or '.join(name for name in targets if targets[name].takes_shaped)}.",
        )


def level_option(trials: Trials) -> dict[str, str]:
    """Return the options, with values, that select the level of ``trials``; {} for the default."""
    others = {"--ends": trials.ends, "--band": trials.band}
    if trials != trials.without_others:
        shares = {name: f"{100.0 * n:.12g} %" for name, n in others.items() if n is not None}
        return level_option(trials.without_others) | shares
    if trials == REPEATED:
        return {}
    if trials.wanted_yield is not None:
        return {"--yield": f"{100.0 * trials.wanted_yield:.12g} %"}
    if trials.machines:
        return {"--tolerances": ""}
    if trials == NOMINAL:
        return {"--nominal": ""}
    return {"--repeats": f"{trials.repeats}"}
