"""How a report looks: one colour, marker and line per tree, the same in every figure, in the page and in 3-D.

The cast is dark grey, the trees take the paper's red, green and purple first. Colours differ in lightness, markers and
dashes differ too, so that a figure survives a grey printer and colour blindness.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any


@dataclass(frozen=True)
class Series:
    """What one tree (or published table) is called and how it is drawn."""

    label: str
    role: str  #: "cast", "tree" or "reference"
    colour: str
    marker: str
    dash: str | tuple[int, tuple[float, ...]]

    @property
    def line(self) -> dict[str, Any]:
        """Keyword arguments for ``Axes.plot``."""
        filled = self.role == "cast"
        return {
            "color": self.colour,
            "marker": self.marker,
            "linestyle": self.dash,
            "label": self.label,
            "markerfacecolor": self.colour if filled else "white",
            "markeredgecolor": self.colour,
            "linewidth": 2.0 if filled else 1.6,
            "zorder": 3 if filled else 4,
        }


CAST = ("#2b3036", "o", "-")
REFERENCE = ("#8a6d1a", "X", (0, (1, 1.5)))
TREES: tuple[tuple[str, str, Any], ...] = (
    ("#d1352b", "s", (0, (5, 1.6))),
    ("#2f9e58", "^", (0, (1.2, 1.2))),
    ("#6b2f8a", "D", (0, (6, 1.5, 1.2, 1.5))),
    ("#2679b8", "v", (0, (3, 1))),
    ("#b5651d", "P", (0, (8, 2))),
    ("#159a9c", "<", (0, (2, 2))),
)
SURFACE = "#9aa3ac"
LOOP_COLOUR, SPUR_COLOUR, BREAK_COLOUR = "#c77700", "#0067a5", "#a3177a"
INK, MUTED, RULE = "#1d2126", "#5b636c", "#d7dbdf"

_RC: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": RULE,
    "grid.linewidth": 0.5,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.markersize": 5.0,
    "savefig.facecolor": "white",
    "figure.facecolor": "white",
    "figure.dpi": 100,
    "svg.hashsalt": "vascval",
    "svg.fonttype": "path",
    "path.simplify": True,
    "text.parse_math": False,
    "axes.formatter.use_mathtext": False,
}


def rc() -> Any:
    """A copy of the matplotlib settings of every figure."""
    return dict(_RC)


def short_name(source: str) -> str:
    """The file's name without folder and without its usual suffixes; other text as it is."""
    return _stem(PurePath(source.replace("\\", "/")).name or source)


def _stem(name: str) -> str:
    return re.sub(r"\.(nrrd|nhdr|nii(\.gz)?|mha|mhd|tiff?|vtp|vtk|swc|gxl(\.xml)?|csv)$", "", name, flags=re.I) or name


def styled(cast: str, trees: Sequence[str], reference: str | None = None) -> list[Series]:
    """Labels and looks of the cast, the trees and a published reference (if any), in that order.

    Sources of one name are told apart by folders and suffixes, those that are the same even so by a number.
    """
    wanted: list[tuple[str, str, Any]] = [("cast", cast, CAST)]
    wanted += [("tree", name, TREES[i % len(TREES)]) for i, name in enumerate(trees)]
    if reference is not None:
        wanted.append(("reference", reference, REFERENCE))
    labels = [short_name(source) for _, source, _ in wanted]
    for longer in (_stem, str):
        labels = [longer(source) if labels.count(label) > 1 else label for label, (_, source, _) in zip(labels, wanted)]
    series = []
    for k, (role, _, look) in enumerate(wanted):
        before = labels[:k].count(labels[k])
        series.append(Series(f"{labels[k]} ({before + 1})" if before else labels[k], role, *look))
    return series
