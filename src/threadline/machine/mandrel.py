"""The profile of a mandrel: its radius along a linear axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass as plain_dataclass
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from threadline.base.arrays import FloatArray
from threadline.machine.quantity import Quantity, Units

_MOST_PLACES = 1000


@dataclass(frozen=True, slots=True, kw_only=True, config=ConfigDict(extra="forbid"))
class Mandrel:
    """Radii of a mandrel at positions of a linear axis."""

    along: str
    """The linear axis along the mandrel: ``"X"``."""
    at: Annotated[tuple[Annotated[Quantity, Units(("m",))], ...], Field(max_length=_MOST_PLACES)]
    """Increasing positions of that axis, at least two."""
    radius: tuple[Annotated[Quantity, Units(("m",), positive=True)], ...]
    """Radius at each position: linear between two positions (a cone), constant beyond the ends."""

    @model_validator(mode="after")
    def _a_table(self) -> Mandrel:
        if len(self.at) != len(self.radius) or len(self.at) < 2:
            raise ValueError(
                f"a profile needs a radius for each of at least 2 positions; this one has "
                f"{len(self.at)} positions and {len(self.radius)} radii"
            )
        for before, after in zip(self.at, self.at[1:], strict=False):
            if before.si >= after.si:
                raise ValueError(
                    f"the positions of a profile must increase; {before.si:g} m is followed by "
                    f"{after.si:g} m"
                )
        return self

    @property
    def largest_m(self) -> float:
        """The largest radius."""
        return max(radius.si for radius in self.radius)


@plain_dataclass(frozen=True, slots=True, eq=False)
class _Cones:
    """Radius / largest radius of the rotary axis in column ``turning``, over the axis ``along``."""

    turning: int
    along: int
    at_m: FloatArray
    share: FloatArray

    def at(self, places_m: FloatArray) -> FloatArray:
        return np.interp(places_m, self.at_m, self.share)

    def most_between(self, first_m: FloatArray, second_m: FloatArray) -> FloatArray:
        most = np.maximum(self.at(first_m), self.at(second_m))
        low, high = np.minimum(first_m, second_m), np.maximum(first_m, second_m)
        for place, share in zip(self.at_m, self.share, strict=True):
            passed = (low < place) & (place < high) & (share > most)
            most[passed] = share
        return most


@plain_dataclass(frozen=True, slots=True, eq=False)
class LocalRadii:
    """Local radius of each axis as a share of its largest radius, by position.

    A small difference of positions, times ``radius_m`` of the path, times the shares at that
    position, gives a length on the surface. Shares are above 0 and at most 1. An axis without a
    profile has the share 1.
    """

    cones: tuple[_Cones, ...]

    def shares(self, positions: FloatArray, axis: int = -1) -> FloatArray:
        """Return the shares at ``positions``, m or rad, in an array of the same shape.

        ``axis`` is the dimension of ``positions`` along which the machine's axes are counted.
        """
        places = np.moveaxis(positions, axis, -1)
        shares = np.ones_like(places)
        for cones in self.cones:
            shares[..., cones.turning] = cones.at(places[..., cones.along])
        return np.ascontiguousarray(np.moveaxis(shares, -1, axis))

    def most_between(self, positions: FloatArray) -> FloatArray:
        """Return the (n - 1, axes) largest shares on the segments between (n, axes) positions."""
        largest = np.ones_like(positions[1:])
        for cones in self.cones:
            places = positions[:, cones.along]
            largest[:, cones.turning] = cones.most_between(places[:-1], places[1:])
        return largest


def local_radii(profiles: Mapping[str, Mandrel], axes: Sequence[str]) -> LocalRadii | None:
    """Return the shares for a path of ``axes``, or None if they are 1 everywhere.

    Parameters
    ----------
    profiles
        By the name of the rotary axis. A path without this axis, or without the linear axis of the
        profile, has the largest radius everywhere.
    """
    cones = tuple(
        _Cones(
            axes.index(name),
            axes.index(profile.along),
            np.array([place.si for place in profile.at]),
            np.array([radius.si for radius in profile.radius]) / profile.largest_m,
        )
        for name, profile in profiles.items()
        if name in axes and profile.along in axes
    )
    return LocalRadii(cones) if cones else None
