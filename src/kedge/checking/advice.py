"""A check in words: what is wrong, what to write into the rig, what drive would tell more."""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from kedge.checking.check import Checked, Evidence
from kedge.checking.search import Trial
from kedge.checking.setting import CONTROL, noise_of
from kedge.checking.summary import (
    CoverageScore,
    Finding,
    Quantity,
    SensorCheck,
    StreamScore,
)
from kedge.vehicles.augmented import Augmented

Names = Mapping[str, tuple[str, ...]]
WORDS = {"scale": "scale", "clock": "clock offset", "arm": "lever arm"}
UNITS = {"scale": "", "clock": " s", "arm": " m"}
VAGUE = {"scale": 0.05, "clock": 0.1, "arm": 0.2}
"""Standard deviations from which on a log does not tell of a quantity."""
MANOEUVRES = {
    "scale": "drive faster and slower, and turn to both sides",
    "clock": "speed up, brake and turn: at a constant speed a late clock is a lever arm",
    "arm": "turn in both directions while the sensor reads",
    "heading": "drive some metres straight while positions are read",
    "attitude": "drive some metres straight, and turn, while positions are read",
    "bias": "stand still for a while, then turn to both sides",
    "position": "see more of the targets, from several sides",
    "velocity": "drive while positions are read",
}


def findings(checked: Checked, names: Names) -> list[Finding]:
    """All that is wrong, with what to write into the rig."""
    stuck = [
        Finding(
            "stuck", name,
            f"{name}: reads the same from {begin:.1f} s to {end:.1f} s while the vehicle moves",
            "leave these readings out, or look at the driver",
        )
        for name, evidence in checked.sensors.items()
        for begin, end in evidence.stuck
    ]  # fmt: skip
    supported = [_finding(checked, trial, names) for trial in checked.trials]
    return (
        stuck + supported + [f for n, s in checked.sensors.items() for f in _unexplained(n, s)]
    )


def _finding(checked: Checked, trial: Trial, names: Names) -> Finding:
    kind, name, part, value, seconds = trial.change
    within = "" if trial.std is None else f" (+-{2 * trial.std:.2g})"
    value = round(value, 6)
    rig, key = checked.setting.rig, f"[sensors.{name}]"
    advice = ""
    if kind == "scale":
        text = f"{name}: {part} reads {1 + value:.4g}{within} times what it should"
        advice = _scale_advice(checked, name, part, 1 / (1 + value))
    elif kind == "sign":
        text = f"{name}: {part} has the other sign"
        advice = f'turn the sign of the column, or say frame = "ned", for {name}.{part}'
    elif kind == "clock":
        late = "late" if value > 0 else "early"
        text = f"{name}: stamped {abs(value):.3g}{within} s too {late}"
        latency = rig.sensors[rig.index(name)].latency + value
        advice = f"{key} latency = {latency:.3g}"
    elif kind == "arm":
        mount = rig.sensors[rig.index(name)].mount
        place = float(getattr(mount, part)) + value
        text = f"{name}: sits {abs(value):.3g}{within} m elsewhere in {part}"
        advice = f"{key} mount.{part} = {place:.3g}"
    elif kind == "noise":
        factor = math.exp(value)
        text = f"{name}: noise is about {factor:.2g} times what is declared"
        numbers = [(t.key, t.value * factor) for t in noise_of(checked.setting, name)]
        advice = (
            "; ".join(f"{k} = {v:.3g}" for k, v in numbers) or f"{key} std: times {factor:.2g}"
        )
    elif kind == "error":
        std = value * checked.noise[name]
        text = (
            f"{name}: beside white noise it errs by {_several(std)}, for about {seconds:.2g} s "
            "at a time"
        )
        advice = f"{key} error = {{ std = {_several(std)}, time_constant = {seconds:.2g} }}"
    else:
        ids = names.get(name, ())
        one, other = (ids[i] if i < len(ids) else str(i) for i in map(int, part.split(",")))
        text = f"{name}: targets {one} and {other} are exchanged"
        advice = f"exchange the places of {one} and {other} on the map"
    return Finding(kind, name, text, advice, value, trial.gain.total)


def _scale_advice(checked: Checked, name: str, part: str, factor: float) -> str:
    rig = checked.setting.rig
    if name == CONTROL:
        vehicle = rig.vehicle.vehicle if isinstance(rig.vehicle, Augmented) else rig.vehicle
        scale = getattr(vehicle, f"{part}_scale", None)
        if scale is not None and np.ndim(scale) == 0:
            return f"[vehicle] parameters.{part}_scale = {float(scale) * factor:.4g}"
    return f"multiply the column of {name}.{part} by {factor:.4g}"


def _unexplained(name: str, evidence: Evidence) -> Iterator[Finding]:
    if evidence.far:
        yield Finding(
            "far", name,
            f"{name}: readings are {evidence.noise_ratio:.2g} times further off than claimed, "
            "and no scale, sign, clock, place, noise or memory explains it",
            "look at the place, the map and the units; these results are not to be trusted",
        )  # fmt: skip
    elif (few := evidence.uncovered) is not None:
        yield Finding(
            "coverage", name,
            f"{name}: held back for {few.horizon:g} s, only {few.inside:.0%} of its readings "
            "lie where 95 % were expected",
            "an error with a memory in another sensor, or more noise of the vehicle",
        )  # fmt: skip


def _several(values: np.ndarray) -> str:
    texts = [f"{v:.2g}" for v in np.atleast_1d(values)]
    return texts[0] if len(set(texts)) == 1 else f"[{', '.join(texts)}]"


def sensor_checks(checked: Checked, names: Names) -> dict[str, SensorCheck]:
    """What the log shows of each sensor."""
    wrong = findings(checked, names)
    return {
        name: SensorCheck(
            readings=evidence.readings,
            verdict=_verdict(evidence, [f for f in wrong if f.subject == name]),
            stream=None if evidence.stream is None else StreamScore(*evidence.stream),
            targets={
                names[name][target] if target < len(names.get(name, ())) else str(target): (
                    StreamScore(*entry)
                )
                for target, entry in evidence.targets.items()
            },
            noise_ratio=evidence.noise_ratio,
            lag_1=None
            if evidence.memory is None
            else float(evidence.memory.whiteness.autocorrelation[0]),
            white=None if evidence.memory is None else not evidence.memory.suspicious,
            memory=evidence.memory.time_constant
            if evidence.memory and evidence.memory.suspicious
            else None,
            coverage={
                f"{c.horizon:g}" if np.isfinite(c.horizon) else "for good": CoverageScore(
                    c.inside, c.stretches
                )
                for c in evidence.coverage
            },
            unfit=tuple(evidence.unfit),
        )
        for name, evidence in checked.sensors.items()
    }


def _verdict(evidence: Evidence, wrong: list[Finding]) -> str:
    if not evidence.readings:
        return "has no readings in this log"
    if wrong:
        return "; ".join(finding.text.partition(": ")[2] for finding in wrong)
    if evidence.noise_ratio is None:
        return "no reading could be judged"
    if evidence.noise_ratio < 0.6:
        return "fits; its noise is declared larger than it looks, which is right if errors last"
    return "fits"


def quantities(checked: Checked) -> dict[str, Quantity]:
    """Clocks, scales and arms by name: how far the log lets them be known."""
    return {
        " ".join(
            filter(None, (t.change.subject, t.change.part, WORDS[t.change.kind]))
        ): Quantity(t.change.value, t.std)
        for t in checked.all_trials
        if t.change.kind in WORDS
    }


def undetermined(checked: Checked) -> list[str]:
    """What the log could not determine, and the drive that would help."""
    lines = []
    for trial in checked.all_trials:
        kind = trial.change.kind
        if kind in WORDS and (trial.std is None or trial.std > VAGUE[kind]):
            what = " ".join(
                filter(None, (trial.change.subject, trial.change.part, WORDS[kind]))
            )
            known = (
                "not at all" if trial.std is None else f"to {2 * trial.std:.2g}{UNITS[kind]}"
            )
            lines.append(f"{what}: known {known}; {MANOEUVRES[kind]}")
    for direction in checked.directions:
        names = ", ".join(direction.components)
        hint = next((text for word, text in MANOEUVRES.items() if word in names), "")
        lines.append(f"{names}: the log says less than the prior{'; ' + hint if hint else ''}")
    return lines
