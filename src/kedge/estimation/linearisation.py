"""A vehicle and its sensors as a linear system about a state: what control engineers read."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import expm

from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ContractError, DataError
from kedge.core.manifolds import space, space_of
from kedge.estimation.rig import Installation, Rig

UNSEEN = 1e-9
"""Singular value, in the largest, below which a direction counts as zero."""


class LinearSystem(NamedTuple):
    r"""$\dot{e} = A e + B \delta u + w$, $\delta z = C e + v$, with e in the tangent space.

    $w$ is white with the spectral density Q, $v$ has the covariance R. Sensors of kedge read
    the state alone, so there is no D: it is zero.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    A: Float[np.ndarray, "n n"]
    B: Float[np.ndarray, "n u"]
    C: Float[np.ndarray, "z n"]
    D: Float[np.ndarray, "z u"]
    Q: Float[np.ndarray, "n n"]
    """Squares of the states' units per second."""
    R: Float[np.ndarray, "z z"]

    def discretised(self, dt: float) -> "Discretised":
        r"""Over a step of ``dt`` s, with the control held: $F$, $G$ and the noise $Q_d$.

        $\exp\left(\begin{bmatrix} A & B \\ 0 & 0 \end{bmatrix} \Delta t\right)$ has F and G in
        its first row; $Q_d = \int_0^{\Delta t} e^{As} Q e^{A^\top s} ds$.

        Raises:
            DataError: ``dt`` is not above 0.

        Source: C. Van Loan, "Computing integrals involving the matrix exponential", IEEE
        Transactions on Automatic Control 23, 1978.
        """
        if not 0 < dt < np.inf:
            raise DataError(f"dt: found {dt:g} s, expected a time above 0")
        n, u = self.B.shape
        held = np.zeros((n + u, n + u))
        held[:n, :n], held[:n, n:] = self.A, self.B
        both = expm(held * dt)
        noise = np.zeros((2 * n, 2 * n))
        noise[:n, :n], noise[:n, n:], noise[n:, n:] = -self.A, self.Q, self.A.T
        grown = expm(noise * dt)
        F = grown[n:, n:].T
        return Discretised(both[:n, :n], both[:n, n:], F @ grown[:n, n:])

    def eigenvalues(self) -> np.ndarray:
        """Of A, the slowest first."""
        values = np.linalg.eigvals(self.A)
        return values[np.lexsort((values.imag, np.abs(values)))]

    def observability(self) -> "Rank":
        r"""Of $[C; CA; \dots; CA^{n-1}]$: what the outputs tell of the states."""
        return _rank(self.A.T, self.C.T, self.states)

    def controllability(self) -> "Rank":
        r"""Of $[B, AB, \dots, A^{n-1}B]$: where the inputs can move the states."""
        return _rank(self.A, self.B, self.states)


class Discretised(NamedTuple):
    """A linear system over one step."""

    F: Float[np.ndarray, "n n"]
    G: Float[np.ndarray, "n u"]
    Q: Float[np.ndarray, "n n"]


class Rank(NamedTuple):
    """How many directions of the state are reached, and which components lie in the others."""

    rank: int
    missing: tuple[str, ...]


def _rank(A: np.ndarray, B: np.ndarray, labels: tuple[str, ...]) -> Rank:
    """By orthogonal bases of the spaces that B, AB, ... span: powers of A would overflow."""
    basis = np.zeros((len(A), 0))
    block, scale = B, max(float(np.abs(B).max(initial=0.0)), 1e-300)
    while block.size and basis.shape[1] < len(A):
        for _ in range(2):  # twice is enough, by Kahan
            block = block - basis @ (basis.T @ block)
        left, size, _ = np.linalg.svd(block, full_matrices=False)
        fresh = left[:, size > UNSEEN * scale]
        basis, block = np.hstack([basis, fresh]), A @ fresh
        scale = max(float(np.abs(A).max(initial=0.0)), 1e-300)
    beside = np.eye(len(A)) - basis @ basis.T
    missing = [name for name, part in zip(labels, beside.diagonal(), strict=True) if part > 0.1]
    return Rank(basis.shape[1], tuple(missing))


@eqx.filter_jit
def matrices(
    vehicle: AbstractVehicle, state: Any, control: Any
) -> tuple[Float[Array, "n n"], Float[Array, "n u"], Float[Array, "n n"]]:
    r"""A, B and Q of a vehicle about a state and a control.

    $A = \partial^2 \phi / \partial e\, \partial \Delta t$ at $\Delta t = 0$, where $\phi(e,
    \Delta t)$ is the step from $x \boxplus e$, in the tangent space at x: so it serves vehicles
    that are given by their step as well as those that are given by their rates.
    """
    states, inputs = space(state), space(control)
    density = vehicle.noise_density()
    still = jax.tree.map(jnp.zeros_like, density)
    noises = space(density)

    def rate(error: Array, turned: Array, shock: Array) -> Float[Array, " n"]:
        begin = states.boxplus(state, error)
        driven = inputs.boxplus(control, turned)
        noise = noises.boxplus(still, shock)

        def step(dt: Array) -> Float[Array, " n"]:
            return states.boxminus(vehicle.step(begin, driven, noise, dt), state)

        return jax.jvp(step, (jnp.zeros(()),), (jnp.ones(()),))[1]

    at = states.zeros(), inputs.zeros(), noises.zeros()
    A, B, G = jax.jacfwd(rate, argnums=(0, 1, 2))(*at)
    strength = noises.flatten(density)
    return A, B, (G * strength[None, :] ** 2) @ G.T


def linearise(rig: Rig, state: Any = None, control: Any = None) -> LinearSystem:
    """The rig about a state (the prior's mean) and a control (the nominal one at the start).

    Sensors over a map have as many outputs as targets times components.

    Raises:
        DataError: state or control is not finite, or a derivative is not.
        ContractError: they are those of another vehicle, or this one has no derivative.

    Source: A. Gelb (ed.), "Applied Optimal Estimation", 1974, section 6.1 (extended filter).
    """
    state = rig.prior.mean if state is None else state
    control = rig.vehicle.nominal_control(jnp.zeros(())) if control is None else control
    _require("state", state, rig.prior.mean)
    _require("control", control, rig.vehicle.nominal_control(jnp.zeros(())))
    control = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), control)
    A, B, Q = (np.asarray(part) for part in matrices(rig.vehicle, state, control))
    rows, blocks, outputs = [np.zeros((0, len(A)))], [], []
    for one in rig.sensors:
        for target in range(one.targets or 1):
            C, R = (np.asarray(part) for part in _output(one, state, jnp.asarray(target)))
            rows.append(C)
            blocks.append(R)
            name = one.name if one.targets is None else f"{one.name}[{target}]"
            outputs += [f"{name}.{label}" for label in space_of(one.sensor.measures).labels]
    C, R = np.concatenate(rows), _diagonal(blocks)
    system = LinearSystem(
        space(state).labels, space(control).labels, tuple(outputs), A, B, C,
        np.zeros((len(C), B.shape[1])), Q, R,
    )  # fmt: skip
    for name in ("A", "B", "C", "Q", "R"):
        if not np.isfinite(getattr(system, name)).all():
            raise DataError(f"{name} is not finite at this state: no derivative there")
    return system


def _require(what: str, given: Any, known: Any) -> None:
    """Refuse a state or a control that is not one of the rig's.

    Raises:
        ContractError: it is of another class or shape.
        DataError: it is not finite.
    """
    expected = f"expected {type(known).__name__}({', '.join(getattr(known, '_fields', ()))})"
    if type(given) is not type(known):
        raise ContractError(f"{what}: found {type(given).__name__}, {expected}")
    shapes = [list(map(np.shape, jax.tree.leaves(tree))) for tree in (given, known)]
    if shapes[0] != shapes[1]:
        raise ContractError(f"{what}: found shapes {shapes[0]}, expected {shapes[1]}")
    if not all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(given)):
        raise DataError(f"{what}: found {given}, expected finite numbers")


def _diagonal(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """The blocks along the diagonal of a matrix of zeros."""
    size = sum(len(block) for block in blocks)
    whole, begin = np.zeros((size, size)), 0
    for block in blocks:
        end = begin + len(block)
        whole[begin:end, begin:end] = block
        begin = end
    return whole


@eqx.filter_jit
def _output(
    one: Installation, state: Any, target: Array
) -> tuple[Float[Array, "m n"], Float[Array, "m m"]]:
    states, outputs = space(state), space_of(one.sensor.measures)
    expected = one.expect(state, target)

    def reading(error: Array) -> Float[Array, " m"]:
        return outputs.boxminus(one.expect(states.boxplus(state, error), target), expected)

    return jax.jacfwd(reading)(states.zeros()), one.noise_cov(state, target)
