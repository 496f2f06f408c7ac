"""Finite elements of plates with an edge crack that share nothing with the package's.

Rectangles of eight nodes in plane stress, fine at the crack's tip; centrifugal stress, geometric
stiffness and spin softening of a rotor about x; and harmonic balance of lips that breathe, by
dynamic compliances of many modes and of static ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product
from typing import Any

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import eigsh, splu

CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, -1], [1, 0], [0, 1], [-1, 0]], float)
GAUSS = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 9.0


def shapes(r: float, s: float) -> tuple[np.ndarray, np.ndarray]:
    """Shape functions (8,) of a serendipity element, and their derivatives (2, 8)."""
    a, b = CORNERS.T
    corner, across = np.arange(8) < 4, a == 0.0
    value = np.where(
        corner,
        0.25 * (1 + a * r) * (1 + b * s) * (a * r + b * s - 1),
        np.where(across, 0.5 * (1 - r**2) * (1 + b * s), 0.5 * (1 + a * r) * (1 - s**2)),
    )
    by_r = np.where(
        corner,
        0.25 * a * (1 + b * s) * (2 * a * r + b * s),
        np.where(across, -r * (1 + b * s), 0.5 * a * (1 - s**2)),
    )
    by_s = np.where(
        corner,
        0.25 * b * (1 + a * r) * (a * r + 2 * b * s),
        np.where(across, 0.5 * b * (1 - r**2), -s * (1 + a * r)),
    )
    return value, np.stack([by_r, by_s])


def graded(start: float, stop: float, fine: float, ratio: float, *, at_end: bool) -> np.ndarray:
    """Lines from a start to a stop, whose distances grow from a fine one at one end."""
    count = int(np.ceil(np.log(1.0 + (stop - start) * (ratio - 1.0) / fine) / np.log(ratio)))
    steps = ratio ** np.arange(count)
    places = np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])
    if at_end:
        places = 1.0 - places[::-1]
    return start + (stop - start) * places


def mesh(size: tuple[float, float], length: float, height: float, longest: float) -> Any:
    """Nodes (n, 2) and elements (m, 8) of a plate with an edge crack, fine at its tip."""
    fine = length / 16.0
    lines = []
    for tip, whole, ratio in ((length, size[0], 1.3), (height, size[1], 1.25)):
        before = graded(0.0, tip, fine, ratio, at_end=True)
        found = np.unique([*before, *graded(tip, whole, fine, ratio, at_end=False)])
        parts = (np.linspace(a, b, int(np.ceil((b - a) / longest)) + 1) for a, b in pairwise(found))
        lines.append(np.append(np.concatenate([part[:-1] for part in parts]), whole))
    numbers: dict[tuple[float, float, int], int] = {}
    nodes: list[tuple[float, float]] = []

    def number(px: float, py: float, upper: bool) -> int:
        lip = int(upper and abs(py - height) < 1e-9 and px < length - 1e-9)
        key = (round(px, 10), round(py, 10), lip)
        if key not in numbers:
            numbers[key] = len(nodes)
            nodes.append((px, py))
        return numbers[key]

    elements = []
    for low, high in pairwise(lines[1]):
        for left, right in pairwise(lines[0]):
            middle, half = 0.5 * (left + right), 0.5 * (right - left)
            up, tall = 0.5 * (low + high), 0.5 * (high - low)
            upper = low >= height - 1e-9
            elements.append([number(middle + a * half, up + b * tall, upper) for a, b in CORNERS])
    return np.array(nodes), np.array(elements)


@dataclass(frozen=True)
class Plate:
    """A plate that is clamped at y = 0.

    Attributes
    ----------
    size : (width, height, thickness) [m]
    young, poisson, density : float
    length, place : float [m]
        Of the crack.
    cracked : bool
        Whether it is there.
    hub : float [m]
        Where y = 0 is, from the axis.
    taper : float
        Of the thickness, from the clamp to the tip.
    clamp : float [m]
        Height of the plate's own material that a soft clamp is as soft as; 0: rigid.
    longest : float [m]
        Of an element.
    """

    size: tuple[float, float, float]
    young: float
    poisson: float
    density: float
    length: float
    place: float
    cracked: bool = True
    hub: float = 0.0
    taper: float = 0.0
    clamp: float = 0.0
    longest: float = 0.006

    @cached_property
    def nodes(self) -> np.ndarray:
        """Places of nodes (n, 2)."""
        return np.asarray(self._mesh[0])

    @cached_property
    def _mesh(self) -> tuple[np.ndarray, np.ndarray]:
        nodes, elements = mesh(self.size[:2], self.length, self.place, self.longest)
        if not self.cracked:  # both lips are one
            same = {tuple(np.round(one, 10)): k for k, one in reversed([*enumerate(nodes)])}
            elements = np.array([same[tuple(np.round(one, 10))] for one in nodes])[elements]
        return nodes, elements

    @cached_property
    def free(self) -> np.ndarray:
        """Which dofs move: (2n,)."""
        nodes, elements = self._mesh
        found = np.zeros((len(nodes), 2), dtype=bool)
        found[np.unique(elements)] = True
        if not self.clamp:
            found[nodes[:, 1] < 1e-12] = False
        return found.ravel()

    @cached_property
    def matrices(self) -> tuple[Any, Any, Any]:
        """Elastic, by the square of the speed, and mass, of the dofs that move."""
        nodes, elements = self._mesh
        law = np.diag([1.0, 1.0, 0.5 * (1.0 - self.poisson)])
        law[0, 1] = law[1, 0] = self.poisson
        law *= self.young / (1.0 - self.poisson**2)
        points = []
        for (r, wr), (s, ws) in product(zip(GAUSS, WEIGHTS, strict=True), repeat=2):
            value, by = shapes(r, s)
            half = 0.5 * np.ptp(nodes[elements], axis=1)
            up = nodes[elements][..., 1] @ value
            thick = self.size[2] * (1.0 + self.taper * (0.5 - up / self.size[1]))
            points.append((value, by / half[:, :, None], wr * ws * half.prod(axis=1) * thick, up))
        strains = [_strain(slopes) for _, slopes, *_ in points]
        pairs = list(zip(strains, points, strict=True))
        stiffness = sum(p[2][:, None, None] * (b.transpose(0, 2, 1) @ law @ b) for b, p in pairs)
        mass = sum(w[:, None, None] * np.outer(v, v) for v, _, w, _ in points) * self.density
        dofs = (2 * elements[..., None] + np.arange(2)).reshape(len(elements), -1)
        elastic = self._put(stiffness, dofs) + self._bed()
        inertia = self._put(np.kron(mass, np.eye(2)), dofs)
        if not self.hub:
            return elastic, None, inertia
        softening = self._put(np.kron(mass, np.diag([0.0, 1.0])), dofs)
        pull = np.zeros(2 * len(nodes))
        for value, _, w, up in points:
            np.add.at(pull, dofs[:, 1::2], self.density * (w * (self.hub + up))[:, None] * value)
        moved = np.zeros(2 * len(nodes))
        moved[self.free] = splu(elastic.tocsc()).solve(pull[self.free])
        geometric = 0.0
        for strain, (_, slopes, w, _) in pairs:
            xx, yy, xy = (law @ (strain @ moved[dofs][..., None]))[..., 0].T
            tensor = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
            inner = slopes.transpose(0, 2, 1) @ tensor @ slopes
            geometric = geometric + w[:, None, None] * inner
        return elastic, self._put(np.kron(geometric, np.eye(2)), dofs) - softening, inertia

    def _bed(self) -> Any:
        """Springs of a soft clamp, as of a layer of the plate's material."""
        springs = np.zeros((len(self.nodes), 2))
        if self.clamp:
            foot = np.flatnonzero(self.nodes[:, 1] < 1e-12)
            foot = foot[np.argsort(self.nodes[foot, 0])]
            for first, middle, last in zip(foot[:-2:2], foot[1::2], foot[2::2], strict=True):
                width = self.nodes[last, 0] - self.nodes[first, 0]
                each = self.young * self.size[2] * width / self.clamp / 6.0
                springs[[first, middle, last]] += each * np.outer([1.0, 4.0, 1.0], [0.4, 1.0])
        return sparse.diags(springs.ravel()[self.free])

    def _put(self, parts: np.ndarray, dofs: np.ndarray) -> Any:
        rows = np.repeat(dofs, dofs.shape[1], axis=1).ravel()
        columns = np.tile(dofs, (1, dofs.shape[1])).ravel()
        shape = (len(self.free),) * 2
        whole = sparse.coo_matrix((parts.ravel(), (rows, columns)), shape).tocsr()
        return whole[self.free][:, self.free]

    def frequencies(self, count: int = 2, rpm: float = 0.0, stiffer: float = 1.0) -> np.ndarray:
        """The first natural frequencies [Hz] at a speed, of so many times the modulus."""
        elastic, rotating, mass = self.matrices
        stiffness = stiffer * elastic
        if rpm:
            stiffness = stiffness + (rpm * np.pi / 30.0) ** 2 * rotating
        start = np.ones(stiffness.shape[0])
        squares = eigsh(stiffness.tocsc(), count, mass.tocsc(), sigma=0.0, v0=start)[0]
        return np.sqrt(np.sort(squares)) / (2.0 * np.pi)

    # --- lips that breathe ------------------------------------------------------------------------

    @cached_property
    def _lips(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nodes of the lower and the upper lip, and the area that each pair stands for [m^2]."""
        nodes, elements = self._mesh
        pairs: dict[tuple[float, ...], list[int]] = {}
        for k in np.unique(elements):
            pairs.setdefault(tuple(np.round(nodes[k], 10)), []).append(int(k))
        two = sorted((where[0], sorted(ks)) for where, ks in pairs.items() if len(ks) == 2)
        places = np.array([*[x for x, _ in two], self.length])
        areas = np.zeros(len(places))
        for at in range(0, len(places) - 2, 2):
            whole = places[at + 2] - places[at]
            areas[at : at + 3] += np.array([1.0, 4.0, 1.0]) / 6.0 * whole * self.size[2]
        lower = np.array([ks[0] for _, ks in two])
        upper = np.array([ks[1] for _, ks in two])
        return lower, upper, areas[:-1]

    def _columns(self, dofs: list[tuple[int, float]]) -> np.ndarray:
        column = np.zeros(len(self.free))
        for dof, value in dofs:
            column[dof] += value
        return column[self.free]

    @cached_property
    def _basis(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of the gaps and the tip, x and y: squares of frequencies (n,), modes there (n, p + 2),
        and static compliances (p + 2, p + 2)."""
        elastic, _, mass = self.matrices
        lower, upper, _ = self._lips
        tip = int(np.argmin(np.sum((self.nodes - self.size[:2]) ** 2, axis=1)))
        seen = [
            self._columns([(2 * a + 1, -1.0), (2 * b + 1, 1.0)])
            for a, b in zip(lower, upper, strict=True)
        ]
        seen += [self._columns([(2 * tip + k, 1.0)]) for k in (0, 1)]
        columns = np.array(seen).T
        squares, modes = eigsh(
            elastic.tocsc(), 24, mass.tocsc(), sigma=0.0, v0=np.ones(elastic.shape[0])
        )
        static = columns.T @ splu(elastic.tocsc()).solve(columns)
        return squares, modes.T @ columns, static

    def ratios(
        self,
        hertz: float,
        force: tuple[float, float],
        ratio: float,
        penalty: float,
        orders: int = 15,
    ) -> np.ndarray:
        """Amplitudes of harmonics 1 to 3 of the tip's displacement, x and y, under a force
        (force sin) there: (2, 3), by harmonic balance with a normal stiffness of the lips [N/m^3]
        (Newton's method from lips that are open)."""
        squares, modes, static = self._basis
        areas = self._lips[2]
        count = len(areas)
        omega, root = 2.0 * np.pi * hertz, np.sqrt(squares)
        rest = static - modes.T @ (modes / squares[:, None])
        compliance = []
        for k in range(orders + 1):
            pole = squares - (k * omega) ** 2 + 2j * ratio * root * k * omega
            compliance.append(modes.T @ (modes / pole[:, None]) + rest)
        load = np.concatenate([np.zeros(count), force])
        outer = -1j * compliance[1] @ load  # of exp(i t): sin
        samples = 16 * orders
        angles = 2.0 * np.pi * np.arange(samples) / samples
        waves = [np.ones(samples)]
        for k in range(1, orders + 1):
            waves += [np.cos(k * angles), np.sin(k * angles)]
        shape = np.array(waves).T  # (samples, 2 orders + 1)
        back = np.linalg.pinv(shape)
        size = 2 * orders + 1

        def by_forces(rows: slice, columns: slice) -> np.ndarray:
            """Real coefficients of motions by those of forces: (size, rows, size, columns)."""
            found = []
            for k, one in enumerate(compliance):
                part = one[rows, columns]
                # cos and sin of a motion: U = a - i b
                found.append(
                    part.real[None, :, None, :]
                    if k == 0
                    else np.array([[part.real, part.imag], [-part.imag, part.real]]).transpose(
                        0, 2, 1, 3
                    )
                )
            whole = np.zeros((size, found[0].shape[1], size, found[0].shape[3]))
            whole[:1, :, :1] = found[0]
            for k in range(1, orders + 1):
                at = slice(2 * k - 1, 2 * k + 1)
                whole[at, :, at] = found[k]
            return whole

        pairs, tips = slice(0, count), slice(count, count + 2)
        own = by_forces(pairs, pairs).reshape(size * count, size * count)
        start = np.zeros((size, count))
        start[1], start[2] = outer[pairs].real, -outer[pairs].imag
        gap = start.copy()

        def balance(
            gap: np.ndarray, stiff: np.ndarray
        ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            there = shape @ gap
            shut = there < 0.0
            forces = back @ (-stiff * np.where(shut, there, 0.0))
            return gap.ravel() - start.ravel() - own @ forces.ravel(), shut, forces

        for softer in (1e-3, 1e-2, 1e-1, 1.0):
            stiff = softer * penalty * areas
            left, shut, forces = balance(gap, stiff)
            for _ in range(100):
                if np.abs(left).max() < 1e-8 * np.abs(start).max():
                    break
                slope = np.einsum("as,sj,sb->ajb", back, -stiff * shut, shape)
                inner = np.zeros((size, count, size, count))
                for j in range(count):
                    inner[:, j, :, j] = slope[:, j]
                jacobian = np.eye(size * count) - own @ inner.reshape(size * count, size * count)
                step, part = np.linalg.solve(jacobian, left).reshape(size, count), 1.0
                while part > 1e-3:
                    other = balance(gap - part * step, stiff)
                    if np.linalg.norm(other[0]) < np.linalg.norm(left):
                        break
                    part *= 0.5
                gap, (left, shut, forces) = gap - part * step, other
            else:
                raise ArithmeticError("no balance")
        motion = np.zeros((size, 2))
        motion[1], motion[2] = outer[tips].real, -outer[tips].imag
        motion += np.tensordot(by_forces(tips, pairs), forces, axes=2)
        return np.array([np.hypot(motion[2 * k - 1], motion[2 * k]) for k in (1, 2, 3)]).T


def _strain(slopes: np.ndarray) -> np.ndarray:
    """Strains by displacements of an element: (m, 3, 16)."""
    found = np.zeros((len(slopes), 3, 16))
    found[:, 0, ::2] = found[:, 2, 1::2] = slopes[:, 0]
    found[:, 1, 1::2] = found[:, 2, ::2] = slopes[:, 1]
    return found
