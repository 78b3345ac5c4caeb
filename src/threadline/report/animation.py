"""Animations of a machine at work: a film (.mp4), a moving picture (.gif), or a page (.html).

All three formats show the same scene. It has the machine, the planned path as a dashed line, and
the actual path. The line of the actual path is darker and wider where the error is larger. A graph
below shows the error over time and its limit. No information depends on colour alone. The HTML page
holds its own data and script, and loads nothing from a network.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.base.progress import Progress
from threadline.base.writing import staged_file
from threadline.errors import OptionError
from threadline.report.scenes import FIXED, Scene, scene_of
from threadline.report.style import LIMIT, PLANNED, figure_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from threadline.proof.pipeline import Proof

DRAWING = "drawing the animation"
_SHADES = ("#a9c4dc", "#3f7fb5", "#c04f00", "#2b0f00")
"""Colours of the actual path by increasing error; each is darker than the one before, also in grey
print."""
_SIZE_IN, _DPI = (7.2, 5.2), 100
_THIN, _THICK = 1.3, 3.6
_BEHIND = "0.82"


def needs_of(file: Path) -> None:
    """Refuse a file that cannot become an animation, before anything is simulated.

    Raises
    ------
    OptionError
        If no animation format has this ending, or the file is a film and ffmpeg is not installed.
    """
    ending = file.suffix.lower()
    if ending not in WRITERS:
        raise OptionError(
            f"{file.name!r} is no animation",
            remedy=f"Give a file that ends in {', '.join(WRITERS)}.",
        )
    if ending == ".mp4":
        from matplotlib.animation import FFMpegWriter

        if not FFMpegWriter.isAvailable():
            raise OptionError(
                f"{file.name!r} is a film, which ffmpeg writes, and there is no ffmpeg here",
                remedy="Install ffmpeg, or give a .gif or an .html.",
            )


def write_animation(proof: Proof, file: Path, progress: Progress | None = None) -> Scene:
    """Write the animation of a proof; return its scene.

    Raises
    ------
    OptionError
        As ``needs_of``.
    """
    needs_of(file)
    scene = scene_of(proof)
    WRITERS[file.suffix.lower()](scene, file, progress)
    return scene


def _extent(scene: Scene) -> tuple[float, float, float, float]:
    """Return the limits of the picture in mm: left, right, bottom, top."""
    corners = []
    for line in scene.lines:
        group = scene.groups.get(line.group)
        for frame in range(0, scene.frames, 8) if group is not None else (0,):
            corners.append(_placed(scene, line.points, line.group, frame))
    for frame in range(0, scene.frames, 8):
        corners.append(_placed(scene, scene.actual[:: scene.per_frame], scene.group, frame))
    points = np.vstack(corners)
    (left, bottom), (right, top) = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    margin = 0.03 * max(right - left, top - bottom)
    return left - margin, right + margin, bottom - margin, top + margin


def _turned(scene: Scene, points: FloatArray, group: str, frame: int) -> FloatArray:
    motion = scene.groups.get(group)
    if motion is None:
        return points
    cos, sin = np.cos(motion.angle[frame]), np.sin(motion.angle[frame])
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
    return np.asarray(points @ rotation.T + motion.shift[frame])


def _placed(scene: Scene, points: FloatArray, group: str, frame: int) -> FloatArray:
    """Return (n, 2) the points in picture coordinates, mm, at a frame."""
    return np.asarray(_turned(scene, points, group, frame) @ scene.view.T)


def _hidden(scene: Scene, points: FloatArray, frame: int) -> NDArray[np.bool_]:
    """Return (n,) whether each point of the path is on the far side of a turning mandrel."""
    if scene.group == FIXED or not scene.groups[scene.group].angle.any():
        return np.zeros(len(points), dtype=bool)
    radial = _turned(scene, points, scene.group, frame) * np.array([0.0, 1.0, 1.0])
    return np.asarray(radial @ scene.towards < 0.0, dtype=np.bool_)


def _widest(scene: Scene) -> float:
    """Return the error at which the line of the path is darkest and widest, in the scene's unit."""
    if scene.limit:
        return 1.8 * scene.limit
    return float(scene.error.max()) if len(scene.error) and scene.error.any() else 1.0


@dataclass(slots=True)
class _Picture:
    """A figure that is drawn again for each frame."""

    scene: Scene
    figure: Figure
    machine: Axes
    graph: Axes | None
    artists: list[Any]

    def draw(self, frame: int) -> None:
        from matplotlib.collections import LineCollection

        scene = self.scene
        for artist in self.artists:
            artist.remove()
        self.artists = []
        for line in scene.lines:
            points = _placed(scene, line.points, line.group, frame)
            self.artists += self.machine.plot(
                *points.T, color=str(1.0 - line.grey), linewidth=line.width, zorder=2
            )
        # The whole planned path is drawn in every frame. On a mandrel its far side is hidden.
        last = frame * scene.per_frame + 1
        planned = _placed(scene, scene.planned, scene.group, frame)
        is_hidden = _hidden(scene, scene.planned, frame)
        self.artists += self.machine.plot(
            *np.where(is_hidden[:, None], np.nan, planned).T,
            **(PLANNED | {"linewidth": 0.9, "zorder": 3}),
        )
        travelled = _placed(scene, scene.actual[:last], scene.group, frame)
        segments = np.stack([travelled[:-1], travelled[1:]], axis=1)
        far_side = _hidden(scene, scene.actual[:last], frame)[1:]
        self.artists.append(
            self.machine.add_collection(
                LineCollection(list(segments[far_side]), colors=_BEHIND, linewidths=0.7, zorder=1)
            )
        )
        share = _shares(scene)[1:last][~far_side]
        path = LineCollection(
            list(segments[~far_side]), linewidths=(_THIN + (_THICK - _THIN) * share).tolist(),
            cmap=_shades(), capstyle="round", zorder=4,
        )  # fmt: skip
        path.set_array(share)
        path.set_clim(0.0, 1.0)
        self.artists.append(self.machine.add_collection(path))
        now_s = float(scene.time_s[frame])
        caption = f"{now_s:.2f} s"
        if len(scene.error):
            caption += f"   {scene.error_words} {scene.error[last - 1]:.2f} {scene.unit}"
        self.artists.append(
            self.machine.text(0.0, 0.01, caption, transform=self.machine.transAxes, fontsize=9)
        )
        if self.graph is not None:
            self.artists.append(self.graph.axvline(now_s, color="black", linewidth=1.2))


def _shares(scene: Scene) -> FloatArray:
    """Return (samples,) darkness and width of the path, from 0 to 1; constant without an error."""
    if not len(scene.error):
        return np.full(len(scene.actual), 0.3)
    return np.clip(scene.error / _widest(scene), 0.0, 1.0)


def _shades() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("error", list(_SHADES))


def _picture(scene: Scene) -> _Picture:
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_IN, dpi=_DPI)
    graph = None
    if len(scene.error):
        machine, graph = figure.subplots(2, 1, height_ratios=(4.2, 1.0))
        times = np.linspace(scene.time_s[0], scene.time_s[-1], len(scene.error))
        graph.plot(times, scene.error, color="#0072B2", linewidth=1.0)
        if scene.limit:
            graph.axhline(scene.limit, **LIMIT)
            graph.text(times[-1], scene.limit, " limit", va="center", fontsize=8)
        graph.set_xlim(times[0], times[-1])
        graph.set_ylim(bottom=0.0)
        graph.set_xlabel("s")
        graph.set_ylabel(scene.unit)
    else:
        machine = figure.subplots()
    title = "\n".join([f"{scene.title}, {_pace(scene)}", *scene.facts])
    machine.set_title(title, fontsize=9, wrap=True)
    left, right, bottom, top = _extent(scene)
    machine.set_xlim(left, right)
    machine.set_ylim(bottom, top)
    machine.set_aspect("equal")
    machine.axis("off")
    for name, dashed in scene.labels:
        style = PLANNED if dashed else {"color": _SHADES[1], "linewidth": 2.0}
        machine.plot([], [], label=name, **style)
    figure.legend(loc="outside lower center", ncols=2, fontsize=7)
    return _Picture(scene, figure, machine, graph, [])


def still(scene: Scene, frame: int) -> Figure:
    """Return the figure of one frame, in the style of the caller."""
    picture = _picture(scene)
    picture.draw(frame)
    return picture.figure


def _pace(scene: Scene) -> str:
    factor = scene.speed
    if abs(factor - 1.0) < 0.02:
        return "in real time"
    return (
        f"{factor:.3g} times as fast as it is" if factor > 1.0 else f"slowed {1 / factor:.3g} times"
    )


def _frames(scene: Scene, progress: Progress | None) -> Iterator[int]:
    for frame in range(scene.frames):
        if progress is not None:
            progress(DRAWING, frame / scene.frames)
        yield frame


def _write_with(writer: Any, scene: Scene, file: Path, progress: Progress | None) -> None:
    from tempfile import TemporaryDirectory

    with figure_style(), TemporaryDirectory(prefix="threadline-film-") as folder:
        picture = _picture(scene)
        film_file = Path(folder) / f"film{file.suffix.lower()}"
        picture.draw(0)
        picture.figure.get_layout_engine().execute(picture.figure)  # type: ignore[union-attr]
        picture.figure.set_layout_engine(None)
        with writer.saving(picture.figure, str(film_file), _DPI):
            for frame in _frames(scene, progress):
                picture.draw(frame)
                writer.grab_frame()
        with staged_file(file) as stream:
            stream.write(film_file.read_bytes())


def _write_gif(scene: Scene, file: Path, progress: Progress | None) -> None:
    from matplotlib.animation import PillowWriter

    _write_with(PillowWriter(fps=_per_second(scene)), scene, file, progress)


def _write_mp4(scene: Scene, file: Path, progress: Progress | None) -> None:
    from matplotlib.animation import FFMpegWriter

    _write_with(FFMpegWriter(fps=_per_second(scene)), scene, file, progress)


def _per_second(scene: Scene) -> int:
    return max(1, round(scene.frames / scene.played_s))


def _write_html(scene: Scene, file: Path, progress: Progress | None) -> None:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    if progress is not None:
        progress(DRAWING, 0.0)
    environment = Environment(
        loader=PackageLoader("threadline.report"), autoescape=True, undefined=StrictUndefined
    )
    content = json.dumps(page_data(scene), separators=(",", ":"), allow_nan=False)
    # No text may end the script: "<" is written as an escape that JSON reads back.
    data = Markup(content.replace("<", "\\u003c").replace("&", "\\u0026"))  # noqa: S704
    page = environment.get_template("animation.html").render(
        title=scene.title, facts=scene.facts, pace=_pace(scene), data=data
    )
    with staged_file(file) as stream:
        stream.write(page.encode())


def page_data(scene: Scene) -> Mapping[str, Any]:
    """Return the data that the script of a page draws, in mm to 0.01 mm, as JSON content."""

    def listed(points: FloatArray, digits: int = 2) -> list[Any]:
        rounded = np.round(points, digits)
        return [None if np.isnan(row).any() else row.tolist() for row in rounded]

    return {
        "lines": [
            {
                "p": listed(line.points),
                "g": line.group,
                "c": round(255 * (1 - line.grey)),
                "w": line.width,
            }
            for line in scene.lines
        ],
        "groups": {
            name: {"s": listed(group.shift), "a": np.round(group.angle, 5).tolist()}
            for name, group in scene.groups.items()
        },
        "group": scene.group,
        "view": scene.view.tolist(),
        "towards": scene.towards.tolist(),
        "actual": listed(scene.actual),
        "planned": listed(scene.planned),
        "error": np.round(scene.error, 4).tolist(),
        "share": np.round(_shares(scene), 3).tolist(),
        "limit": scene.limit,
        "words": scene.error_words,
        "unit": scene.unit,
        "time": np.round(scene.time_s, 4).tolist(),
        "played": scene.played_s,
        "per": scene.per_frame,
        "extent": list(_extent(scene)),
        "shades": list(_SHADES),
    }


WRITERS: Mapping[str, Callable[[Scene, Path, Progress | None], None]] = {
    ".mp4": _write_mp4,
    ".gif": _write_gif,
    ".html": _write_html,
}
"""The formats of animations by the ending of their files."""
