"""The optimal topology of a tree: moves, simulated annealing, and the exhaustive optimum of small trees."""
