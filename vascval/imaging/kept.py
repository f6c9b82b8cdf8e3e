"""A skeleton as plain values and arrays, which a checkpoint holds, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vascval.core.tree import Topology, Tree
from vascval.imaging.runs import Runs
from vascval.imaging.skeletonization import Skeleton
from vascval.io.volumes import Volume

_COLUMN = "column."


def kept(skeleton: Skeleton) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """JSON values, and arrays of integers and floats by name: all that :func:`taken_up` needs."""
    tree, runs, frame = skeleton.tree, skeleton._runs, skeleton._frame
    arrays = {
        "parent": tree.parent, "position_mm": tree.position_mm, "radius_mm": tree.radius_mm,
        "loops_mm": skeleton.loops_mm, "spurs_mm": skeleton.spurs_mm, "breaks_mm": skeleton.breaks_mm,
        "row_offset": runs.row_offset, "start": runs.start, "stop": runs.stop,
        "spacing_mm": frame.spacing_mm, "origin_mm": frame.origin_mm, "direction": frame.direction,
    }  # fmt: skip
    if tree.polyline_mm is not None and tree.polyline_offset is not None:
        arrays |= {"polyline_mm": tree.polyline_mm, "polyline_offset": tree.polyline_offset}
    arrays |= {_COLUMN + name: values for name, values in tree.columns.items()}
    return {"image": skeleton.image, "meta": dict(tree.meta), "shape": list(runs.shape)}, arrays


def taken_up(record: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Skeleton:
    """The skeleton that :func:`kept` was given.

    :raises KeyError, ValueError, InputError: when something is missing or not sound.
    """
    columns = {name.removeprefix(_COLUMN): values for name, values in arrays.items() if name.startswith(_COLUMN)}
    tree = Tree(
        Topology(arrays["parent"]), arrays["position_mm"], arrays["radius_mm"], columns,
        arrays.get("polyline_mm"), arrays.get("polyline_offset"), record["meta"],
    )  # fmt: skip
    nz, ny, nx = record["shape"]
    runs = Runs((nz, ny, nx), arrays["row_offset"], arrays["start"], arrays["stop"])
    frame = Volume(np.zeros((1, 1, 1), dtype=np.uint8), arrays["spacing_mm"], arrays["origin_mm"], arrays["direction"])
    loops_mm, spurs_mm, breaks_mm = (arrays[name] for name in ("loops_mm", "spurs_mm", "breaks_mm"))
    return Skeleton(tree, record["image"], loops_mm, spurs_mm, breaks_mm, runs, frame)
