"""From a volume to a tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vascval.core.contraction import contract_degenerate
from vascval.core.tree import Topology, Tree
from vascval.imaging import graph, refine, runs
from vascval.imaging.distance import distance_map
from vascval.imaging.runs import Runs
from vascval.imaging.thinning import thin
from vascval.imaging.tips import find_tips
from vascval.imaging.voxels import Voxels, from_runs
