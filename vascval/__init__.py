"""Vascular trees from micro-CT of corrosion casts and from optimisation: skeletonise, measure, compare.

Importing this package loads nothing heavy; the subpackages are rooms of their own:

* :mod:`vascval.core`: the tree and what is true of every tree
* :mod:`vascval.io`: reading and writing volumes, trees and tables
* :mod:`vascval.imaging`: segmented volume to tree
* :mod:`vascval.morphometry`: measures of one tree
* :mod:`vascval.comparison`: cast against synthetic trees
* :mod:`vascval.report`: figures and the HTML report
* :mod:`vascval.cli`: the command line
"""

__version__ = "0.1.0"
