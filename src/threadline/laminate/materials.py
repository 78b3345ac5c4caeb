"""Materials: fibres, resins and prepregs of the library and of a product file.

A band's material is ``FIBRE/RESIN`` or the name of a prepreg: ``e-glass/epoxy``, ``t300-5208``.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal, NoReturn, get_args

from threadline.base.wording import nearest
from threadline.errors import UnitError
from threadline.laminate.theory import Ply, ply_of
from threadline.machine.quantity import Quantity, parse_machine_quantity

Kind = Literal["fibre", "resin", "prepreg"]
KINDS: tuple[Kind, ...] = get_args(Kind)
MOST_FIBRE_VOLUME = 0.9069
"""Share of equal round fibres packed as densely as they can: pi / (2 sqrt(3))."""
_UNITS: Mapping[str, str] = {
    "density": "kg/m^3", "modulus": "Pa", "along": "Pa", "across": "Pa", "shear": "Pa",
    "poisson": "", "strength": "Pa", "fibre_volume": "",
}  # fmt: skip
_NUMBERS: Mapping[Kind, tuple[str, ...]] = {
    "fibre": ("density", "modulus", "across", "shear", "poisson", "strength"),
    "resin": ("density", "modulus", "poisson", "strength"),
    "prepreg": ("fibre_volume", "density", "along", "across", "shear", "poisson", "strength"),
}
_WORDS = ("title", "price")
_OWN = ("name", "kind", "like")
_PRICE = re.compile(r"\s*(?P<value>[^\sA-Za-z]+)\s*(?P<currency>[A-Z]{3})\s*/\s*kg\b(?P<rest>.*)")
_PRICE_LIKE = 'price = "2.5 EUR/kg +- 10 %, printed: offer of May"'
_LIKE = {"kg/m^3": "1.6 g/cm^3", "Pa": "74 GPa", "": "0.2"}
_MOST_NUMBER, _MOST_PRICE = 1e15, 1e6
Refusing = Callable[[str, str, str], NoReturn]
"""Refuses a key of a material with a message and a remedy."""


@dataclass(frozen=True, slots=True)
class Price:
    """A price per kilogram in a currency (three letters)."""

    per_kg: float
    currency: str


@dataclass(frozen=True, slots=True)
class Material:
    """A fibre, a resin or a prepreg.

    Parameters
    ----------
    kind, name, title
        Kind, name and title of the material.
    numbers
        Numbers in SI, with tolerance and source, by key of the file.
    price
        Price; None: unknown.
    fibre
        Name of the fibre in a prepreg.
    """

    kind: Kind
    name: str
    title: str
    numbers: Mapping[str, Quantity]
    price: Price | None
    fibre: str = ""

    def __getitem__(self, key: str) -> float:
        """Return a number in SI."""
        return self.numbers[key].si


@dataclass(frozen=True, slots=True)
class Composite:
    """Material of a band: fibres, and a resin or the prepreg that holds both.

    Parameters
    ----------
    name
        Name, as in the product file.
    fibre, resin, prepreg
        Materials; either the resin or the prepreg is None.
    """

    name: str
    fibre: Material
    resin: Material | None
    prepreg: Material | None

    @property
    def fibre_volume(self) -> float | None:
        """Share of the fibres in the volume of a prepreg; None where the winding decides."""
        return None if self.prepreg is None else self.prepreg["fibre_volume"]

    @property
    def resin_density(self) -> float:
        """Density of the resin, kg/m^3; of a prepreg, from the densities of ply and fibre."""
        if self.resin is not None:
            return self.resin["density"]
        assert self.prepreg is not None
        share = self.prepreg["fibre_volume"]
        return (self.prepreg["density"] - share * self.fibre["density"]) / (1.0 - share)

    @property
    def strength(self) -> float:
        """Strength of the fibres, Pa; of a prepreg, ply strength divided by fibre volume."""
        if self.prepreg is None:
            return self.fibre["strength"]
        return self.prepreg["strength"] / self.prepreg["fibre_volume"]

    def ply(self, fibre_volume: float) -> Ply:
        """Return the elastic constants of a layer of parallel fibres."""
        if self.prepreg is not None:
            numbers = (self.prepreg[key] for key in ("along", "across", "poisson", "shear"))
            return Ply(*numbers)
        assert self.resin is not None
        fibre = (
            self.fibre["modulus"], self.fibre["across"], self.fibre["shear"], self.fibre["poisson"],
        )  # fmt: skip
        return ply_of(fibre, (self.resin["modulus"], self.resin["poisson"]), fibre_volume)

    @property
    def prices(self) -> tuple[Price, ...]:
        """Known prices of its materials."""
        every = (self.prepreg,) if self.prepreg is not None else (self.fibre, self.resin)
        return tuple(one.price for one in every if one is not None and one.price is not None)

    def cost(self, fibre_kg: float, resin_kg: float) -> Price | None:
        """Return the total cost of fibre and resin, in ``per_kg`` of a price; None: unknown."""
        if self.prepreg is not None:
            price = self.prepreg.price
            kg = fibre_kg + resin_kg
            return None if price is None else Price(price.per_kg * kg, price.currency)
        assert self.resin is not None
        first, second = self.fibre.price, self.resin.price
        if first is None or second is None or first.currency != second.currency:
            return None
        return Price(first.per_kg * fibre_kg + second.per_kg * resin_kg, first.currency)


@cache
def library() -> Mapping[str, Material]:
    """Return the materials of the library by name."""
    text = resources.files(__package__).joinpath("materials.toml").read_text(encoding="utf-8")

    def fault(key: str, message: str, _remedy: str) -> NoReturn:
        raise AssertionError(f"materials.toml: {key}: {message}")

    found = {}
    for kind, rows in tomllib.loads(text).items():
        for name, row in rows.items():
            found[name] = material_of({**row, "name": name, "kind": kind}, {}, fault)
    return found


def material_of(
    row: Mapping[str, Any], known: Mapping[str, Material], refuse: Refusing
) -> Material:
    """Return the material of a table.

    Parameters
    ----------
    row
        ``name``; ``kind`` with all numbers of that kind, or ``like`` with the numbers that differ.
    known
        Materials that ``like`` may name.
    refuse
        Refuses a key.
    """
    name = row.get("name")
    if not isinstance(name, str) or not re.fullmatch(r"[a-z0-9][a-z0-9-]{0,39}", name):
        why = f"a material has the name {str(name)[:40]!r}, and names have a-z, 0-9 and hyphens"
        refuse("name", why, 'Like name = "my-glass".')
    like = row.get("like")
    base = None
    if like is not None:
        base = known.get(str(like))
        if base is None:
            refuse("like", f"there is no material {str(like)[:40]!r}", nearest(str(like), known))
        if "kind" in row and row["kind"] != base.kind:
            refuse("kind", f"{base.name} is a {base.kind}", "Leave kind out.")
    kind = base.kind if base is not None else row.get("kind")
    if kind not in KINDS:
        refuse(
            "kind", "a material has no kind" if kind is None else f"no kind {str(kind)[:40]!r}",
            f"There are: {', '.join(KINDS)}; or write like = \"e-glass\".",
        )  # fmt: skip
    keys = (*_OWN, *_WORDS, *_NUMBERS[kind], *(("fibre",) if kind == "prepreg" else ()))
    for key in row:
        if key not in keys:
            refuse(key, f"unknown key {key[:60]!r}", nearest(key, keys))
    numbers = dict(base.numbers) if base is not None else {}
    for key in _NUMBERS[kind]:
        if key in row:
            numbers[key] = _number(key, row[key], refuse)
        elif key not in numbers:
            refuse(key, f"the {kind} {name} has no {key}", 'Write it, or like = "e-glass".')
    share = numbers["fibre_volume"].si if kind == "prepreg" else 0.5
    if not 0.0 < share <= MOST_FIBRE_VOLUME:
        refuse(
            "fibre_volume", f"a fibre volume of {share:.3g}", 'From 1 to 90 %: "60 % exact, ..."'
        )
    title = row.get("title", name if base is None else base.title)
    price = base.price if base is not None else None
    if "price" in row:
        price = _price(row["price"], refuse)
    fibre = str(row.get("fibre", base.fibre if base is not None else ""))
    if kind == "prepreg" and not fibre:
        refuse("fibre", f"the prepreg {name} names no fibre", 'Like fibre = "t300".')
    return Material(kind, name, str(title), numbers, price, fibre)


def _number(key: str, text: Any, refuse: Refusing) -> Quantity:
    like = f'Like {key} = "{_LIKE[_UNITS[key]]} +- 3 %, printed: data sheet".'
    if not isinstance(text, str):
        refuse(key, f"{key} = {str(text)[:40]!r} is not a quantity", like)
    try:
        found = parse_machine_quantity(text, (_UNITS[key],))
    except UnitError as error:
        refuse(key, f"{key}: {error.message}", error.remedy or like)
    if not found.least > 0.0:
        refuse(key, f"{key} = {text[:40]!r} must be above 0", like)
    if found.most > _MOST_NUMBER:
        refuse(key, f"{key} = {text[:40]!r} must be at most {_MOST_NUMBER:g} {_UNITS[key]}", like)
    if key == "poisson" and found.most >= 0.5:
        refuse(key, f"a contraction of {found.si:g} must be below 0.5", like)
    return found


def _price(text: Any, refuse: Refusing) -> Price:
    match = _PRICE.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        refuse("price", f"price = {str(text)[:40]!r} is no price", f"Like {_PRICE_LIKE}.")
    try:
        # A currency is no unit: the number is read with its tolerance and source as if of a mass.
        per_kg = parse_machine_quantity(f"{match['value']} kg{match['rest']}", ("kg",)).si
    except UnitError as error:
        refuse("price", f"price: {error.message}", f"Like {_PRICE_LIKE}.")
    if not 0.0 <= per_kg <= _MOST_PRICE:
        why = f"price = {text[:40]!r} is not from 0 to {_MOST_PRICE:g} per kg"
        refuse("price", why, f"Like {_PRICE_LIKE}.")
    return Price(per_kg, match["currency"])


def composite_of(name: Any, known: Mapping[str, Material], refuse: Refusing, key: str) -> Composite:
    """Return the material of a band by its name, ``FIBRE/RESIN`` or a prepreg.

    Parameters
    ----------
    known
        Materials by name.
    refuse, key
        Function that refuses a key, and the key that holds the name.
    """
    if not isinstance(name, str):
        refuse(key, f"{key} = {str(name)[:40]!r} is no material", f'Like {key} = "e-glass/epoxy".')

    def named(part: str, kind: Kind) -> Material:
        found = known.get(part)
        if found is None or found.kind != kind:
            of_kind = [one for one, material in known.items() if material.kind == kind]
            refuse(
                key, f"there is no {kind} {part[:40]!r}",
                f"Known: {', '.join(sorted(of_kind))}; or write a [[material]].",
            )  # fmt: skip
        return found

    first, _, second = name.partition("/")
    if second:
        return Composite(name, named(first, "fibre"), named(second, "resin"), None)
    prepreg = named(name, "prepreg")
    return Composite(name, named(prepreg.fibre, "fibre"), None, prepreg)
