"""Auxiliary particle filter: looks at the reading before it chooses whom to move."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jax import lax
from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import LastStep, Particles
from kedge.core.contracts import AbstractMeasurementModel
from kedge.core.registry import filters
from kedge.filters.particle.cloud import AbstractParticleFilter, Sight, Weighed, look
from kedge.filters.particle.redraw import redrawable
from kedge.numerics.noise import draws
from kedge.numerics.resampling import SCHEMES, effective_sample_size, normalised


@filters.add("auxiliary")
class AuxiliaryParticle(AbstractParticleFilter):
    r"""Ancestors are resampled by what their noise-free prediction says of the reading.

    First stage $\lambda_i \propto w_i \, p(z \mid f(x_i, u, 0))$; then the last step is drawn
    anew for the ancestors $a_j$ chosen, with weights
    $p(z \mid x_j) / p(z \mid f(x_{a_j}, u, 0))$.

    The last step is the one between the last two events: of several predictions before one
    reading, the earlier ones stand as they were drawn. Where the first stage's effective size
    is above ``threshold`` of the count, or a reading follows another without a prediction
    between, nothing is redrawn, and the update is the bootstrap filter's.

    Source: M. Pitt and N. Shephard, "Filtering via simulation: auxiliary particle filters", J.
    Am. Stat. Assoc. 94, 1999.
    """

    looks_back: ClassVar[bool] = True

    def weigh(
        self,
        model: AbstractMeasurementModel,
        belief: Particles,
        measurement: Any,
        sight: Sight,
        key: PRNGKeyArray,
    ) -> Weighed:
        """Resample the ancestors, draw their last step anew."""
        as_drawn = belief.log_weights + sight.log_likelihood
        if belief.last is None:
            return Weighed(belief.states, as_drawn)
        last: LastStep = belief.last
        pending, step, std = redrawable(last)
        choose_key, draw_key = jr.split(key)

        def first_stage() -> Any:
            calm = jnp.zeros((self.count, *std.shape), std.dtype)
            centre = look(model, jax.vmap(step)(last.before, calm), measurement)
            return belief.log_weights + centre.log_likelihood, centre.log_likelihood

        unused = belief.log_weights, jnp.zeros_like(belief.log_weights)
        first, centre = lax.cond(pending, first_stage, lambda: unused)
        first, evidence = normalised(first)
        few = effective_sample_size(first) < self.threshold * self.count
        few = few & pending & jnp.isfinite(evidence)

        def second_stage() -> tuple[Any, Any]:
            chosen = SCHEMES[self.resampling](choose_key, first)
            before = jax.tree.map(lambda leaf: leaf[chosen], last.before)
            states = jax.vmap(step, (0, 1))(before, draws(draw_key, self.count, std))
            seen = look(model, states, measurement).log_likelihood
            return states, seen - centre[chosen] + evidence - jnp.log(self.count)

        states, log_weights = lax.cond(few, second_stage, lambda: (belief.states, as_drawn))
        # The ancestors of the next step are chosen when its reading is known.
        return Weighed(states, log_weights, resampled=few, may_resample=~pending)
