"""Compiled sweeps behind :mod:`vascval.core.ordering`: plain loops over a root-first parent array."""

import numpy as np

from vascval.core.jit import njit


@njit
def breadth_first(parent, root):
    n = parent.size
    offset = np.zeros(n + 1, np.int64)
    for i in range(n):
        if i != root:
            offset[parent[i] + 1] += 1
    for i in range(n):
        offset[i + 1] += offset[i]
    fill = offset[:-1].copy()
    child = np.empty(n, np.int64)
    for i in range(n):
        if i != root:
            child[fill[parent[i]]] = i
            fill[parent[i]] += 1
    order = np.empty(n, np.int64)
    order[0] = root
    end = 1
    begin = 0
    while begin < end:
        node = order[begin]
        begin += 1
        for k in range(offset[node], offset[node + 1]):
            order[end] = child[k]
            end += 1
    return order[:end]


@njit
def depth(parent):
    result = np.zeros(parent.size, np.int32)
    for i in range(1, parent.size):
        result[i] = result[parent[i]] + 1
    return result


@njit
def subtree_sum(parent, values):
    result = values.copy()
    for i in range(parent.size - 1, 0, -1):
        result[parent[i]] += result[i]
    return result


@njit
def strahler(parent):
    n = parent.size
    order = np.zeros(n, np.int32)
    shared = np.zeros(n, np.int32)  # how many children share the largest order seen so far
    for i in range(n - 1, -1, -1):
        if order[i] == 0:
            order[i] = 1
        elif shared[i] >= 2:
            order[i] += 1
        if i > 0:
            p = parent[i]
            if order[i] > order[p]:
                order[p] = order[i]
                shared[p] = 1
            elif order[i] == order[p]:
                shared[p] += 1
    return order


@njit
def element(parent, order, radius):
    n = parent.size
    heir = np.full(n, -1, np.int32)  # the child that carries on the element of its parent segment
    for i in range(1, n):
        p = parent[i]
        if p > 0 and order[i] == order[p] and (heir[p] < 0 or radius[i] > radius[heir[p]]):
            heir[p] = i
    result = np.full(n, -1, np.int32)
    count = 0
    for i in range(1, n):
        if heir[parent[i]] == i:
            result[i] = result[parent[i]]
        else:
            result[i] = count
            count += 1
    return result
