"""Tables by order and generation: segments, elements, Horton ratios, connectivity."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vascval.core.ordering import element, root_order
from vascval.core.tree import Tree
from vascval.morphometry.statistics import grouped, log_line


def element_table(tree: Tree, order: np.ndarray) -> pd.DataFrame:
    """One row per element of the given orders (see :class:`vascval.io.rows.ElementRow`), root first.

    The radius is the mean over its segments weighted by length (unweighted where the element has no length). An
    element springs from the one that the segment feeding its first segment belongs to.
    """
    label = element(tree.topology, order, tree.radius_mm)
    index, first, n_segments = np.unique(label[1:], return_index=True, return_counts=True)
    first += 1
    last = np.zeros(index.size, dtype=np.int64)
    np.maximum.at(last, label[1:], np.arange(1, tree.n_nodes))
    length = np.bincount(label[1:], weights=tree.length_mm[1:])
    weight = np.where(length[label] > 0, tree.length_mm, 1.0)[1:]
    radius = np.bincount(label[1:], weights=weight * tree.radius_mm[1:]) / np.bincount(label[1:], weights=weight)
    between = length - (tree.length_mm[first] + tree.length_mm[last]) / 2
    tapers = (n_segments > 1) & (between > 0)
    fall = 1 - tree.radius_mm[last] / tree.radius_mm[first]
    return pd.DataFrame(
        {
            "element": index,
            "parent_element": label[tree.parent[first]],
            "order": order[first],
            "generation": root_order(tree.topology, order) - order[first] + 1,
            "n_segments": n_segments,
            "radius_mm": radius,
            "length_mm": length,
            "taper_per_mm": np.where(tapers, fall / np.where(tapers, between, 1.0), np.nan),
        }
    )


def order_table(ordering: str, order: np.ndarray, segments: pd.DataFrame, elements: pd.DataFrame) -> pd.DataFrame:
    """One row per order, ascending (see :class:`vascval.io.rows.OrderRow`).

    :param order: (N,) order of each segment, entry 0 ignored; ``elements`` is the table for these orders.
    """
    n = int(order[1:].max())
    index, of_element = order[1:] - 1, elements["order"].to_numpy() - 1
    columns: dict[str, object] = {"ordering": ordering, "order": np.arange(1, n + 1)}
    for prefix, table, group in (("", segments, index), ("element_", elements, of_element)):
        columns["n_elements" if prefix else "n_segments"] = np.bincount(group, minlength=n)
        for name in ("radius", "length"):
            values = grouped(table[f"{name}_mm"].to_numpy(), group, n)
            columns[f"{prefix}{name}_mean_mm"] = values.mean
            columns[f"{prefix}{name}_sd_mm"] = values.sd
            columns[f"{prefix}{name}_se_mm"] = values.se
    columns["segments_per_element"] = grouped(elements["n_segments"].to_numpy(float), of_element, n).mean
    columns["taper_mean_per_mm"] = grouped(elements["taper_per_mm"].to_numpy(), of_element, n).mean
    for name in ("tortuosity", "length_to_diameter"):
        columns[f"{name}_mean"] = grouped(segments[name].to_numpy(), index, n).mean
    return pd.DataFrame(columns)


def generation_table(segments: pd.DataFrame, elements: pd.DataFrame, junctions: pd.DataFrame) -> pd.DataFrame:
    """One row per generation, the root's first (see :class:`vascval.io.rows.GenerationRow`).

    Junctions count under the generation of the segment that feeds them, monopodial branches under that of the segment
    they spring from; a junction at the root point, which nothing feeds, is in no row.
    """
    generation = segments["generation"].to_numpy()
    n = int(generation.max())
    index = generation - 1
    fed = junctions[junctions["generation"] > 0]
    feeder = fed["generation"].to_numpy() - 1
    radius = grouped(segments["radius_mm"].to_numpy(), index, n)
    length = grouped(segments["length_mm"].to_numpy(), index, n)
    ratio = grouped(fed["branching_ratio"].to_numpy(), feeder, n)
    sprung = segments["parent"].to_numpy()[segments["monopodial"].to_numpy(bool)]
    return pd.DataFrame(
        {
            "generation": np.arange(1, n + 1),
            "order": np.arange(n, 0, -1),
            "n_segments": radius.n,
            "n_elements": np.bincount(elements["generation"].to_numpy() - 1, minlength=n),
            "radius_mean_mm": radius.mean,
            "radius_sd_mm": radius.sd,
            "length_mean_mm": length.mean,
            "length_sd_mm": length.sd,
            "branching_ratio_mean": ratio.mean,
            "branching_ratio_sd": ratio.sd,
            "n_junctions": ratio.n,
            "n_trifurcations": np.bincount(feeder[fed["n_children"].to_numpy() == 3], minlength=n),
            "n_monopodial": np.bincount(index[sprung], minlength=n),
            "tortuosity_mean": grouped(segments["tortuosity"].to_numpy(), index, n).mean,
            "length_to_diameter_mean": grouped(segments["length_to_diameter"].to_numpy(), index, n).mean,
            "total_length_mm": np.bincount(index, weights=segments["length_mm"].to_numpy(), minlength=n),
        }
    )


def horton_table(ordering: str, orders: pd.DataFrame) -> pd.DataFrame:
    """Horton's number, radius and length ratios (see :class:`vascval.io.rows.HortonRow`).

    The decadic logarithm of the number, mean radius and mean length of the elements is fitted by a straight line over
    the orders, unweighted; the ratio is ``10^|slope|``. Two fits each where there are three orders or more: over all
    orders, and without the highest, whose single element is cut off where the tree begins.
    """
    n = len(orders)
    rows = []
    for last in (n, n - 1) if n >= 3 else (n,):
        for quantity, name in (
            ("number", "n_elements"),
            ("radius", "element_radius_mean_mm"),
            ("length", "element_length_mean_mm"),
        ):
            values = orders[name].to_numpy(float)[:last]
            slope, r_squared = log_line(np.arange(1, last + 1), values)
            rows.append((ordering, quantity, 10 ** abs(slope), slope, r_squared, 1, last, last))
    names = ["ordering", "quantity", "ratio", "slope", "r_squared", "order_min", "order_max", "n_orders"]
    return pd.DataFrame(rows, columns=names)


def connectivity_table(ordering: str, elements: pd.DataFrame) -> pd.DataFrame:
    """The connectivity matrix of Jiang 1994 in long form (see :class:`vascval.io.rows.ConnectivityRow`).

    ``C(m, n)`` is the number of elements of order m that spring directly from elements of order n, along them or at
    their end, divided by the number of elements of order n. All pairs of orders are listed, n by n; stems spring from
    no element. Pivot by ``order_child`` (rows) and ``order_parent`` for the matrix as it is printed.
    """
    order = elements["order"].to_numpy()
    n = int(order.max())
    daughter = elements["parent_element"].to_numpy() >= 0
    count = np.zeros((len(elements), n), dtype=np.int64)
    np.add.at(count, (elements["parent_element"].to_numpy()[daughter], order[daughter] - 1), 1)
    rows = []
    for parent in range(1, n + 1):
        of_parent = count[order == parent]
        for child in range(1, n + 1):
            each = of_parent[:, child - 1]
            se = each.std(ddof=1) / np.sqrt(each.size) if each.size > 1 else np.nan
            rows.append((ordering, child, parent, int(each.sum()), each.size, each.mean(), se))
    names = ["ordering", "order_child", "order_parent", "n_elements", "n_parent_elements", "mean", "se"]
    return pd.DataFrame(rows, columns=names)
