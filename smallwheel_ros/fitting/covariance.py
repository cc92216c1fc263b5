# SPDX-License-Identifier: Apache-2.0
"""A covariance of which most is zero: errors of one block are correlated, those of two blocks are not.

    S = V + U U',   V block diagonal,   U of few columns (what parameters can take up)

    S^-1 = V^-1 - C C',   C = V^-1 U (I + U' V^-1 U)^(-1/2)      (Woodbury 1950)

so that time and memory grow with the number of values, not with its cube.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_SMALL = 24  # of a block: one call of numpy for all of these is quicker than one of scipy for each


def blocks_of(links: Sequence[Index]) -> list[Index]:
    """Values that are linked, directly or by others: arrays of shape (blocks, values of one).

    links: codes of the values, shape (values,); equal codes link, -1 does not.
    """
    size = links[0].size
    nodes, to, first = [], [], size
    for codes in links:
        linked = np.flatnonzero(codes >= 0)
        nodes.append(linked)
        to.append(first + codes[linked])
        first += int(codes.max(initial=-1)) + 1
    ends = np.concatenate(nodes), np.concatenate(to)
    graph = coo_array((np.ones(ends[0].size), ends), shape=(first, first))
    block = connected_components(graph, directed=False)[1][:size]
    order = np.argsort(block, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(block[order])) + 1)
    sizes = sorted({group.size for group in groups})
    return [np.array([g for g in groups if g.size == s], dtype=np.intp) for s in sizes]


class Covariance:
    """S by the blocks of V, each part of shape (blocks, values of one, values of one).

    spread: U, shape (values, columns). Raises LinAlgError where V is not positive definite.
    """

    def __init__(
        self, blocks: Sequence[Index], parts: Sequence[Array], spread: Array | None = None
    ) -> None:
        self._blocks, self._parts = blocks, parts
        self._roots = [np.linalg.cholesky(part) for part in parts]
        self.log_root = float(
            sum(np.log(np.diagonal(root, axis1=1, axis2=2)).sum() for root in self._roots)
        )
        self._spread: tuple[Array, Array] | None = None
        if spread is not None and spread.shape[1]:
            white = self._by_root(spread)
            size, turned = np.linalg.eigh(white.T @ white)
            size = np.maximum(size, 1e-300)
            self.log_root += 0.5 * float(np.log1p(size).sum())
            # (I + A A')^(-1/2) = I - A G A'
            shrunk = (1.0 - 1.0 / np.sqrt(1.0 + size)) / size
            self._spread = white, turned * shrunk @ turned.T

    def _by_root(self, columns: Array, transposed: bool = False) -> Array:
        """L^-1 columns, or L'^-1 columns."""
        found = np.empty(columns.shape)
        wide = columns.reshape(len(columns), -1)
        flat = found.reshape(wide.shape)
        for index, root in zip(self._blocks, self._roots, strict=True):
            if index.shape[1] <= _SMALL:
                flat[index] = np.linalg.solve(
                    root.swapaxes(1, 2) if transposed else root, wide[index]
                )
                continue
            for one, of_block in zip(index, root, strict=True):
                turned = of_block.T if transposed else of_block
                flat[one] = solve_triangular(
                    turned, wide[one], lower=not transposed, check_finite=False
                )
        return found

    def whiten(self, columns: Array) -> Array:
        """Columns whose scalar products are those under S^-1, shape as given, (values, ...)."""
        white = self._by_root(columns)
        return white if self._spread is None else self._shrunk(white)

    def _shrunk(self, white: Array) -> Array:
        assert self._spread is not None
        a, g = self._spread
        return np.asarray(white - a @ (g @ (a.T @ white)))

    def solve(self, columns: Array) -> Array:
        """S^-1 columns."""
        white = self.whiten(columns)
        return self._by_root(white if self._spread is None else self._shrunk(white), True)

    def inverse_parts(self) -> list[Array]:
        """The blocks of S^-1 that V has, each of shape (blocks, values of one, values of one)."""
        found: list[Array] = [np.asarray(np.linalg.inv(part)) for part in self._parts]
        if self._spread is None:
            return found
        a, _ = self._spread
        root = np.linalg.cholesky(np.eye(a.shape[1]) + a.T @ a)
        taken = solve_triangular(root, self._by_root(a, True).T, lower=True, check_finite=False).T
        return [
            part - taken[index] @ taken[index].swapaxes(1, 2)
            for part, index in zip(found, self._blocks, strict=True)
        ]

    def times(self, columns: Array) -> Array:
        """V columns, shape (values, columns)."""
        return self._joined(
            [part @ columns[index] for part, index in zip(self._parts, self._blocks, strict=True)]
        )

    def variance(self) -> Array:
        """The diagonal of V, shape (values,)."""
        return self._joined([np.diagonal(part, axis1=1, axis2=2) for part in self._parts])

    def drawn(self, noise: Array) -> Array:
        """Errors of covariance V from independent ones of variance 1, shape (values, draws)."""
        return self._joined(
            [root @ noise[index] for root, index in zip(self._roots, self._blocks, strict=True)]
        )

    def _joined(self, values: Sequence[Array]) -> Array:
        found = np.empty((sum(index.size for index in self._blocks), *values[0].shape[2:]))
        for index, value in zip(self._blocks, values, strict=True):
            found[index] = value
        return found
