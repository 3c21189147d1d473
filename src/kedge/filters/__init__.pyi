from kedge.filters.ensemble.denkf import DeterministicEnsembleKalman as Denkf
from kedge.filters.ensemble.enkf_n import FiniteSizeEnsembleKalman as EnkfN
from kedge.filters.ensemble.etkf import EnsembleTransformKalman as Etkf
from kedge.filters.ensemble.serial_enkf import SerialEnsembleKalman as SerialEnkf
from kedge.filters.ensemble.stochastic import EnsembleKalman as Ensemble
from kedge.filters.gaussian.additive_unscented import (
    AdditiveUnscentedKalman as AdditiveUnscented,
)
from kedge.filters.gaussian.cubature import CubatureKalman as Cubature
from kedge.filters.gaussian.dead_reckoning import DeadReckoning as DeadReckoning
from kedge.filters.gaussian.extended import ExtendedKalman as Extended
from kedge.filters.gaussian.gauss_hermite import GaussHermiteKalman as GaussHermite
from kedge.filters.gaussian.iterated import IteratedExtendedKalman as Iterated
from kedge.filters.gaussian.kalman import Kalman as Kalman
from kedge.filters.gaussian.posterior_linearisation import (
    PosteriorLinearisation as PosteriorLinearisation,
)
from kedge.filters.gaussian.square_root import SquareRootKalman as SquareRoot
from kedge.filters.gaussian.unscented import UnscentedKalman as Unscented
from kedge.filters.particle.auxiliary import AuxiliaryParticle as Auxiliary
from kedge.filters.particle.bootstrap import BootstrapParticle as Particle
from kedge.filters.particle.guided import GuidedParticle as Guided
from kedge.filters.published.fuzzy import FuzzyKalman as Fuzzy
from kedge.filters.published.fuzzy_noise import FuzzyNoise as FuzzyNoise
from kedge.filters.published.linearised import LinearisedKalman as Linearised
from kedge.filters.published.raw import Raw as Raw
from kedge.filters.wrappers.adaptive import Adaptive as Adaptive
from kedge.filters.wrappers.gate_or_student import GateOrStudent as GateOrStudent
from kedge.filters.wrappers.gated import Gated as Gated
from kedge.filters.wrappers.hypotheses import Hypotheses as Hypotheses
from kedge.filters.wrappers.interacting import InteractingModels as Interacting
from kedge.filters.wrappers.robust import Robust as Robust
from kedge.positioning.snapshot import Snapshot as Fix

__all__ = [
    "Adaptive",
    "AdditiveUnscented",
    "Auxiliary",
    "Cubature",
    "DeadReckoning",
    "Denkf",
    "EnkfN",
    "Ensemble",
    "Etkf",
    "Extended",
    "Fix",
    "Fuzzy",
    "FuzzyNoise",
    "GateOrStudent",
    "Gated",
    "GaussHermite",
    "Guided",
    "Hypotheses",
    "Interacting",
    "Iterated",
    "Kalman",
    "Linearised",
    "Particle",
    "PosteriorLinearisation",
    "Raw",
    "Robust",
    "SerialEnkf",
    "SquareRoot",
    "Unscented",
]
