"""Trees do not depend on the number of threads; ``python -m tests.determinism`` has larger ones, and other Pythons."""

import sys

from tests.determinism import Grown, differing, grown


def test_the_same_bytes_on_any_number_of_threads():
    small = {"box": ("karch-box", "n_terminals=60", "method=full", "topology.tests=2000", "topology.chains=3")}
    made = list(grown([sys.executable], (1, 2, 4), small))
    assert [one.threads for one in made] == [1, 2, 4]
    assert differing(made) == []


def test_a_tree_that_differs_is_told():
    made = [Grown("a", "p", 1, "x"), Grown("a", "q", 1, "x"), Grown("b", "p", 1, "x"), Grown("b", "p", 2, "y")]
    assert differing(made) == ["b"]
