"""Charts of the page by matplotlib: bars with intervals, and curves of trainings."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS: Final = MappingProxyType(
    {"A": "#8c8c8c", "B": "#e69f00", "C": "#56b4e9", "D": "#cc79a7", "E": "#009e73"}
)
"""Of experiments; apart from grey, those of Okabe and Ito, which colour-blind people can distinguish."""

_DASHES: Final = ("solid", (0, (3, 1.5)), (0, (1, 1.5)), (0, (4, 1.5, 1, 1.5)))


@dataclass(frozen=True)
class Chart:
    """An image of a chart, and its title for those who cannot see it."""

    title: str
    uri: str


@dataclass(frozen=True)
class Bar:
    """A bar with its interval, values from 0 to 1; None for one that is unknown."""

    key: str
    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class TrainingCurve:
    """A line through points, and its name."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]


def bar_chart(title: str, groups: Sequence[tuple[str, Sequence[Bar]]]) -> Chart:
    """Bars of IoU in percent by group, with intervals as lines and the value above each."""

    def draw(axes: Axes) -> None:
        for number, (_, bars) in enumerate(groups):
            width = 0.8 / len(bars)
            for place, bar in enumerate(bars):
                middle = number + (place + 0.5) * width - 0.4
                top = 0.0
                if bar.value is not None:
                    top = 100 * bar.value
                    axes.bar(middle, top, 0.95 * width, color=COLOURS[bar.key])
                    label = f"{top:.0f}"
                    if bar.low is not None and bar.high is not None:
                        axes.plot(
                            [middle, middle], [100 * bar.low, 100 * bar.high], color="#1a1a1a", linewidth=1
                        )
                        top = 100 * bar.high
                else:
                    label = "-"
                axes.annotate(
                    label, (middle, top), (0, 2), textcoords="offset points", ha="center", fontsize=7
                )
        axes.set(xticks=range(len(groups)), xticklabels=[name for name, _ in groups], ylim=(0, 105))
        axes.set_yticks(range(0, 101, 20), [f"{tick}%" for tick in range(0, 101, 20)])
        axes.grid(axis="y", color="#d9d9d9")

    return _draw_image(title, (11.2, 3.4), draw)


def curve_chart(title: str, curves: Sequence[TrainingCurve], y_label: str, colour: str) -> Chart:
    """Lines over steps, from 0 upwards, whose names are in a legend."""

    def draw(axes: Axes) -> None:
        for number, curve in enumerate(curves):
            dashes = _DASHES[number % len(_DASHES)]
            axes.plot(
                curve.x, curve.y, color=colour, linestyle=dashes, label=curve.name, marker=".", markevery=[0]
            )
        axes.set(xlabel="step", ylabel=y_label)
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
        axes.grid(axis="y", color="#d9d9d9")
        axes.legend(frameon=False, fontsize=7, loc="upper left", bbox_to_anchor=(1, 1))

    return _draw_image(title, (5.4, 2.6), draw)


def _draw_image(title: str, size_in: tuple[float, float], draw: Callable[[Axes], None]) -> Chart:
    """An image of axes whose content is drawn by `draw`; the same bytes in every run."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    buffer = io.BytesIO()
    style = {"svg.hashsalt": title, "font.size": 9.0, "axes.spines.top": False, "axes.spines.right": False}
    with rc_context(style | {"axes.axisbelow": True}):
        figure = Figure(figsize=size_in, layout="constrained")
        draw(figure.add_subplot())
        figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    content = base64.b64encode(buffer.getvalue()).decode()
    return Chart(title, f"data:image/svg+xml;base64,{content}")
