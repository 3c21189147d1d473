"""A first rig for a log: vehicle, sensors and prior, by the columns that its sources have."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from kedge.apps.first_frames import truth_has_own_frame
from kedge.core.manifolds import Rotation as Turn
from kedge.core.manifolds import columns_of
from kedge.core.registry import vehicles
from kedge.formats.logs import RawLog
from kedge.formats.tables import Table

PLACE, SPACE = {"position_x", "position_y"}, {"position_x", "position_y", "position_z"}
TURN = set(columns_of("attitude", Turn()))
IMU = {f"{name}_{axis}" for name in ("angular_rate", "specific_force") for axis in "xyz"}
BODY = {f"velocity_body_{axis}" for axis in "xyz"}
DRIVEN = (
    ("bicycle", {"speed", "steering"}, "wheelbase = 1.5"),
    ("differential-drive", {"left", "right"}, "track = 0.5"),
    ("unicycle", {"speed", "yaw_rate"}, "speed_noise = 0.05, yaw_rate_noise = 0.02"),
)
"""Vehicles in the plane, what drives them, and what has to be known of them."""
TICKS = "left_metres_per_tick = 0.001, right_metres_per_tick = 0.001, track = 0.5"
IN_PLANE = (
    ("pose", PLACE | {"heading"}, {"position_std": "position_x", "heading_std": "heading"}),
    ("gnss", PLACE, {"std": "position_x"}),
    ("heading", {"heading"}, {"std": "heading"}),
    ("landmarks", {"range", "bearing"}, {"range_std": "range", "bearing_std": "bearing"}),
    ("ranges", {"range"}, {"range_std": "range"}),
)
IN_SPACE = (
    ("gnss3", SPACE, {"horizontal_std": "position_x", "vertical_std": "position_z"}),
    ("attitude", TURN, {}),
    ("doppler", BODY, {"std": "velocity_body_x"}),
    ("depth", {"depth"}, {"std": "depth"}),
    ("ranges3", {"range"}, {"range_std": "range"}),
)
"""Sensors, what they measure, and which column tells which of their deviations."""
MAPPED = ("landmarks", "ranges", "ranges3")
UNTURNED = (
    "# No source says how the vehicle is turned: its heading will drift. Where an instrument",
    "# on board wrote the truth's attitude, make its file one more source, and this a sensor:",
    "# [sensors.NAME_OF_THE_SOURCE]",
    '# model = "attitude"',
)
GUESSED = (
    "# Noises, scales and mounts are guesses: `kedge check` with this rig and log says whether",
    "# the spreads are honest. What lasts in a sensor's error is its `error` = std and",
    "# time_constant.",
)
STD = {"position": 1.0, "heading": 0.5, "velocity": 1.0, "attitude": 0.1, "angular_rate": 0.1}
KNOWN = {"position": 0.1, "heading": 0.05, "attitude": 0.05}
"""What is believed at the start: of what a sensor tells, and of what the truth tells."""


FLOOR = 0.02
"""m or rad: what lasts in an error is not seen in the scatter between readings."""
FLOORS = {"range": 0.1}
"""m: radios err by that for as long as their surroundings are the same."""


def is_planar(sources: Mapping[str, set[str]]) -> bool:
    """Whether something drives a vehicle in the plane."""
    return any(needs <= columns for columns in sources.values() for _, needs, _ in DRIVEN)


def rig_text(raw: RawLog, preamble: str) -> str:
    """A rig file after ``preamble``, which says where the log's sources are."""
    sets = {name: set(table.columns) for name, table in raw.tables.items()}
    apart = truth_has_own_frame(raw)
    known = set() if raw.truth is None or apart else set(raw.truth.columns)
    model, source, parameters = _motion(sets, known)
    counts = source is not None and raw.tables[source].units.get("left") == "1"
    if counts:
        model, parameters = "odometry", TICKS
    start = type(vehicles.get(model)().start())
    planar = "heading" in start._fields
    if model == "wandering" and (
        any(SPACE <= columns for columns in sets.values())
        or any("position_z" in targets.columns for targets in raw.maps.values())
    ):
        model = "wandering3"
    lines = [preamble.rstrip("\n"), "", *GUESSED]
    if apart:
        lines += ["", "# Its axes are not those of the fixes: the path's shape is compared."]
        lines += ["[truth]", "own_frame = true"]
    lines += ["", *_vehicle(model, source, parameters)]
    if counts and source is not None:
        lines += _counted(raw.tables[source])
    driven = "differential-drive" if counts else model
    used = set() if source is None else {c for m, c, _ in DRIVEN if m == driven for c in c}
    fused: dict[str, set[str]] = {}
    for name, table in raw.tables.items():
        free = sets[name] - (used if name == source else set())
        kinds = IN_PLANE if planar or model == "wandering" else IN_SPACE
        for kind, needs, stds in kinds:
            reads = {"attitude", "doppler", "heading", "pose"}
            if kind in reads and not _has(start._fields, kind):
                continue
            if needs <= free and (kind not in MAPPED or table.texts):
                free = free - needs
                label = name if name not in fused else f"{name}_{kind.replace('-', '_')}"
                fused[label] = needs
                lines += _sensor(label, name, kind, table, stds, raw)
    augmented = list(_augmented(raw, fused))
    lines += ["", "[vehicle.augmented]", *augmented] if augmented else []
    if "attitude" in start._fields and not any(needs >= TURN for needs in fused.values()):
        lines += ["", *UNTURNED]
    lines += _prior(model, raw, known, fused)
    lines += ["", "# Each sensor's noise is multiplied by what its innovations ask for; that"]
    lines += ["# of the vehicle stays as it is above. `extended` adapts nothing."]
    lines += ["[filter]", 'name = "adaptive"', "", "[output]", "rate = 10.0"]
    return "\n".join(lines) + "\n"


def _has(fields: Sequence[str], kind: str) -> bool:
    wanted = {"doppler": "velocity_body", "pose": "heading"}.get(kind, kind)
    return wanted in fields


def _motion(sets: Mapping[str, set[str]], known: set[str]) -> tuple[str, str | None, str]:
    """The vehicle, the source that drives it, and its parameters."""
    for model, needs, parameters in DRIVEN:
        for name, columns in sets.items():
            if needs <= columns:
                return model, name, parameters
    for name, columns in sets.items():
        turned = known >= TURN or any(
            columns >= TURN for other, columns in sets.items() if other != name
        )
        if turned and known >= SPACE and columns >= IMU:
            return "strapdown", name, "accelerometer_noise = 0.05, gyroscope_noise = 0.005"
        if (turned or columns >= TURN) and columns >= BODY:
            return "body-twist", None, "acceleration_noise = 0.1, angular_noise = 0.1"
    return "wandering", None, "acceleration_noise = 0.7, memory = 2.0"


def _vehicle(model: str, source: str | None, parameters: str) -> Iterator[str]:
    why = {
        "wandering": "Nothing drives it: a walker, who turns every other second.",
        "wandering3": "Nothing drives it: a walker, who turns every other second.",
        "odometry": "What a tick is in metres, and the track, are to be measured.",
        "strapdown": "The two densities stand on the IMU's data sheet (per root hertz).",
    }.get(model, "How noisy its motion is: `kedge tune` finds it from the log.")
    yield f"# {why} `kedge list vehicles` shows all."
    yield from ("[vehicle]", f'model = "{model}"', f"parameters = {{ {parameters} }}")
    if source is not None:
        yield from ("", "[control]", f'source = "{source}"')


def _counted(table: Table) -> Iterator[str]:
    """How ticks are told, and where they flow over."""
    yield 'sampling = "counts"'
    told = np.stack([table.columns["left"], table.columns["right"]])
    largest = float(np.nanmax(np.abs(told)))
    if np.any(np.abs(np.diff(told)) > largest / 2):
        yield f"counter = {2 ** int(np.ceil(np.log2(largest + 1)))}  # they flow over"


def _sensor(
    label: str, source: str, kind: str, table: Table, stds: Mapping[str, str], raw: RawLog
) -> Iterator[str]:
    rate = (len(table.stamps) - 1) / max(np.ptp(table.stamps) / 1e9, 1e-9)
    yield from ("", f"# {len(table.stamps)} readings, {rate:.3g} Hz.")
    yield from (f"[sensors.{label}]", f'model = "{kind}"')
    if label != source:
        yield f'source = "{source}"'
    if kind in MAPPED:
        yield f'map = "{next(iter(raw.maps), "targets")}"  # where the targets are'
        yield f'target = "{next(iter(table.texts))}"'
    covariance = ["xx", "xy", "xh", "yy", "yh", "hh"]
    if kind == "pose" and set(covariance) <= table.columns.keys():
        yield "covariance = [" + ", ".join(f'"{name}"' for name in covariance) + "]"
    elif stds:
        groups = next(iter(table.texts.values())) if table.texts else None
        scatter = (
            f"{n} = {max(_scatter(table.columns[c], groups), FLOORS.get(c, FLOOR)):.2g}"
            for n, c in stds.items()
        )
        yield f"parameters = {{ {', '.join(scatter)} }}  # scatter between readings"
        yield 'robust = { loss = "student" }  # what is far off counts for less'
    if "range" in table.columns:
        yield "# mount = { x = 0.0, y = 0.0 }  # where on the vehicle it sits, m: measure it"
    yield "# latency = 0.0  # s from the event to its stamp; `kedge tune` finds it"
    yield "# gate = 1e-4  # share of good readings to refuse, once the noise is right"


def _scatter(values: Float[np.ndarray, " n"], groups: Sequence[str] | None) -> float:
    """Twice the white noise of readings, by their second differences."""
    names = np.array(groups if groups is not None else [""] * len(values))
    parts = [np.diff(values[names == name], 2) for name in np.unique(names)]
    changes = np.abs(np.concatenate(parts))
    changes = changes[np.isfinite(changes)]
    white = 1.4826 * float(np.median(changes)) / 6**0.5 if len(changes) else 0.0
    return 2 * white


def _augmented(raw: RawLog, fused: Mapping[str, set[str]]) -> Iterator[str]:
    """Errors that last, of instruments that are known for them."""
    turns = [needs for needs in fused.values() if "heading" in needs]
    if {"heading"} in turns and PLACE | {"heading"} in turns:
        yield "# A heading beside poses: its zero may be where the instrument was switched on."
        yield "heading_bias = { std = 2.0, random_walk = 1e-3 }"
    # Only receivers tell a dilution of precision.
    if any("hdop" in raw.tables[name].columns for name in fused if name in raw.tables):
        yield "# A receiver's errors last for about a minute."
        yield "gnss_bias = { std = 1.5, random_walk = 0.27, time_constant = 60.0 }"


def _prior(
    model: str, raw: RawLog, known: set[str], fused: Mapping[str, set[str]]
) -> Iterator[str]:
    state = vehicles.get(model)().start()
    charts = {name: np.shape(value) for name, value in state._asdict().items()}
    columns = {
        name: ("position_x", "position_y", "position_z")[: shape[0]]
        if name == "position"
        else TURN
        if name == "attitude"
        else (name,)
        for name, shape in charts.items()
    }
    yield from ("", "# What is believed at the start, before any reading.", "[prior]")
    true = [name for name in KNOWN if name in charts and set(columns[name]) <= known]
    if true:
        yield "from_truth = [" + ", ".join(f'"{name}"' for name in true) + "]"
    mean = {}
    # A pose before a heading alone, whose zero may be another.
    for label, needs in sorted(fused.items(), key=lambda entry: -len(entry[1])):
        table = raw.tables.get(label)
        for name in charts:
            if table is None or name in true or name in mean or name == "attitude":
                continue
            if set(columns[name]) <= needs:
                first = [float(np.nanmedian(table.columns[c][:5])) for c in columns[name]]
                mean[name] = f"{name} = [{', '.join(f'{value:.4g}' for value in first)}]"
    if mean:
        yield f"mean = {{ {', '.join(mean.values())} }}  # the first readings"
    stds = {name: KNOWN[name] if name in true else STD.get(name, 1.0) for name in charts}
    if "heading" in charts and "heading" not in (*true, *mean):
        stds["heading"] = 2.0  # nobody tells it
    yield f"std = {{ {', '.join(f'{n} = {v:g}' for n, v in stds.items())} }}"
