"""Systems that nobody drives: what the chaotic test systems share."""

import abc
from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractOdeVehicle
from kedge.core.errors import ContractError
from kedge.core.manifolds import Euclidean
from kedge.core.quantities import Scalar, WhiteNoise


class Control(NamedTuple):
    """Nothing: the system is watched, not driven."""


def values_of(size: int) -> Any:
    """A state class with one field ``values`` of ``size`` numbers; call it once for a size."""
    values = Annotated[Float[Array, str(size)], Euclidean("1", (size,))]
    return NamedTuple("State", [("values", values)])


class AbstractAutonomous(AbstractOdeVehicle[Any, Control, Any]):
    r"""$\dot x = f(x) + w$ with independent white noise on each component.

    A step is ``substeps`` classical Runge-Kutta steps.
    """

    process_noise: WhiteNoise = 0.0
    substeps: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        if self.substeps < 1:
            raise ContractError(
                f"{type(self).__name__}: substeps is {self.substeps}, must be at least 1"
            )

    @abc.abstractmethod
    def flow(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        """Time derivative without noise."""

    def rates(self, state: Any, control: Control, noise: Any) -> Any:
        return type(state)(self.flow(state.values) + noise.values)

    def step(self, state: Any, control: Control, noise: Any, dt: Scalar) -> Any:
        def substep(state: Any, _: None) -> tuple[Any, None]:
            return single(state, control, noise, dt / self.substeps), None

        single = super().step
        if self.substeps == 1:
            return single(state, control, noise, dt)  # straight-line code
        return lax.scan(substep, state, length=self.substeps)[0]

    def noise_density(self) -> Any:
        start = self.start()
        return type(start)(jnp.full(start.values.shape, self.process_noise))

    def nominal_control(self, time: Scalar) -> Control:
        return Control()
