"""Frozen settings per stage, filled from ``pipeline/*.toml`` and a recipe; unknown keys are refused.

The TOML files are the one home of every default and of its reason; the classes state type and range only. What a recipe
may change stands in ``N-stage.toml``; what belongs to a method, in a table per module of ``N-stage-room.toml``.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from crankorder.errors import CrankorderError, ManyErrors, RequestError

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(gt=0)]
Fraction = Annotated[float, Field(gt=0, lt=1)]
Slip = Annotated[float, Field(gt=-50, lt=50)]
LEAST_TOLERANCE, LARGEST_TOLERANCE = 1e-12, 0.1
"""Relative amplitude errors that can be asked for."""
LEAST, MOST = 1e-30, 1e12
"""Size of a number other than 0: beyond these nothing is physical, and products leave the range of the numbers."""
ResultName = Literal[
    "order_map",
    "campbell_map",
    "order_tracks",
    "findings",
    "cycle_average",
    "operating_shapes",
    "envelope_map",
    "vibration_levels",
]
PictureFormat = Literal["png", "svg", "pdf"]

STANDARD_GRAVITY_M_S2 = 9.80665
"""What the unit g stands for (3rd CGPM, 1901), exact and no setting: here, because units are read before NumPy is."""


DERIVATIVE = {"displacement": 0, "velocity": 1, "acceleration": 2}
"""How often each quantity of a vibration is differentiated by time: no setting either, and read as early."""


class StageSettings(BaseModel):
    """Base of every stage's settings."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class IngestSettings(StageSettings):
    """Limits on what is read (``1-ingest.toml``)."""

    max_bytes: Count
    in_memory_bytes: Annotated[int, Field(ge=0)]
    max_objects: Count
    clip_run_samples: Count
    dropout_samples: Count
    dropout_fraction: Fraction
    max_gap_samples: Annotated[int, Field(ge=0)]
    max_gap_fraction: Fraction
    max_missing_fraction: Fraction
    max_clipped_fraction: Fraction
    plateau_exponent: Fraction
    quiet_plateau: Fraction
    spike_ratio: Annotated[float, Field(gt=1)]
    spike_level: Positive
    overload_ratio: Annotated[float, Field(gt=1)]
    decay_share: Fraction
    drift_ratio: Positive
    drift_share: Fraction
    dead_ratio: Fraction
    dead_steps: Count
    mains_share: Fraction
    level_ratio: Annotated[float, Field(gt=1)]
    level_jump_ratio: Annotated[float, Field(gt=1)]
    gain_step_ratio: Annotated[float, Field(gt=1)]
    max_lost_fraction: Fraction
    max_lost_at_ends_fraction: Fraction
    lost_margin_s: Annotated[float, Field(ge=0)]
    fewest_samples: Count
    rate_tolerance: Fraction
    time_jitter_samples: Fraction
    integration_highpass_hz: Positive
    integration_edge_octaves: Positive
    max_time_jitter_samples: Fraction


class ShaftSettings(StageSettings):
    """How pulses become crank angle (``2-shaft.toml``)."""

    hysteresis_fraction: Fraction
    pickup_level_fraction: Fraction
    envelope_teeth: Positive
    double_pulse_ratio: Fraction
    lost_pulse_ratio: Annotated[float, Field(gt=1)]
    max_repaired_fraction: Annotated[float, Field(ge=0, lt=1)]
    kept_order: Positive
    smoothing_margin: Annotated[float, Field(ge=1)]
    speed_lowpass_rev: Positive
    vibration_range_rpm: tuple[Positive, Positive] = Field(strict=False)
    vibration_revs: Annotated[float, Field(ge=3)]
    vibration_slew_per_s: Positive
    vibration_tie: Positive
    reference_bias_limit: Fraction
    reference_irregularity_percent: Annotated[float, Field(ge=0, lt=100)]
    least_tooth_error: Fraction
    largest_swing_percent: Positive


def _one_estimate(method: object) -> object:
    if method in ("least_squares", "vold_kalman"):
        raise ValueError(
            'no such method any more: set "auto", which reads held speeds in frames, close orders solved together, and '
            'follows orders through sweeps together, or "frames", which follows none'
        )
    return method


class OrderSettings(StageSettings):
    """Frames, map and tracks by order (``3-orders.toml``)."""

    max_order: Positive
    revs_per_frame: Count
    overlap: Annotated[float, Field(ge=0, lt=1)]
    speed_bin_rpm: Positive
    track_orders: tuple[Positive, ...] = Field(strict=False)
    band_width_orders: Positive
    tolerance: Annotated[float, Field(ge=LEAST_TOLERANCE, le=LARGEST_TOLERANCE)]
    track_method: Annotated[Literal["auto", "frames"], BeforeValidator(_one_estimate)]
    floor_bins: Count
    guard_bins: Annotated[int, Field(ge=0)]
    envelope_max_order: Positive
    envelope_revs_per_frame: Count
    envelope_longest_s: Positive
    usual_eccentricity_deg: Positive
    largest_eccentricity_deg: Positive
    encoder_proof: Positive
    sideband_slack: Fraction
    own_line_range: Positive
    carrier_over_noise: Annotated[float, Field(gt=1)]


def _rising(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] >= ends[1]:
        raise ValueError("the lower end comes first")
    return ends


def _wide(ends: tuple[float, float]) -> tuple[float, float]:
    if _rising(ends)[1] < BANDS.narrowest_ratio * ends[0]:
        raise ValueError(f"too narrow for a level: the high end is {BANDS.narrowest_ratio:g} times the low one or more")
    return ends


class CampbellSettings(StageSettings):
    """The speed-frequency map (``4-campbell.toml``)."""

    max_frequency_hz: Positive
    resolution_hz: Positive
    overlap: Annotated[float, Field(ge=0, lt=1)]
    window: Literal["hann", "flat-top", "blackman-harris", "kaiser"]
    kaiser_beta: Positive
    amplitude_scaling: Literal["peak", "rms"]
    sweep_order: Positive
    level_bands_hz: tuple[Annotated[tuple[Positive, Positive], Field(strict=False), AfterValidator(_wide)], ...] = (
        Field(strict=False)
    )
    level_quantities: tuple[Literal["acceleration", "velocity", "displacement", "as measured"], ...] = Field(
        strict=False
    )
    level_frame_s: Positive


class IdentifySettings(StageSettings):
    """What counts as an order, a mode, a tone (``5-identify.toml``)."""

    false_alarm_probability: Fraction
    min_speed_fraction: Fraction
    min_speeds: Count
    order_match: Positive
    mode_prominence_db: Positive
    mode_min_width_bins: Positive
    max_damping_ratio: Fraction
    least_damping_ratio: Fraction
    free_amplification: Annotated[float, Field(gt=1)]
    free_confidence: Fraction
    mode_speed_ratio: Annotated[float, Field(ge=1)]
    mains_hz: tuple[Positive, ...] = Field(strict=False)
    mains_tolerance_hz: Positive
    fold_search_hz: Positive
    crossing_band_rpm: Positive
    bearing_slip_percent: Annotated[tuple[Slip, Slip], AfterValidator(_rising)] = Field(strict=False)
    bearing_false_alarm_probability: Fraction


def _different(names: tuple[ResultName, ...]) -> tuple[ResultName, ...]:
    if len(set(names)) < len(names):
        raise ValueError("each result is named once")
    return names


class ReportSettings(StageSettings):
    """What is made, pictures and page (``6-report.toml``)."""

    results: Annotated[tuple[ResultName, ...], AfterValidator(_different)] = Field(strict=False, min_length=1)
    pictures: bool
    picture_format: PictureFormat
    width_in: Positive
    height_in: Positive
    dpi: Count
    dynamic_range_db: Positive
    acceleration_reference_m_s2: Positive
    pressure_reference_pa: Positive
    max_labelled_orders: Count
    max_name_characters: Count


class Settings(StageSettings):
    """All stages' settings, as one recipe asks for them."""

    ingest: IngestSettings
    shaft: ShaftSettings
    orders: OrderSettings
    campbell: CampbellSettings
    identify: IdentifySettings
    report: ReportSettings

    file_of: ClassVar[dict[str, str]] = {
        stage: f"{number}-{stage}.toml"
        for number, stage in enumerate(("ingest", "shaft", "orders", "campbell", "identify", "report"), start=1)
    }


@cache
def _tables(file: str) -> Mapping[str, Mapping[str, object]]:
    return tomllib.loads(files("crankorder.pipeline").joinpath(file).read_text(encoding="utf-8"))


class MethodNumbers:
    """Numbers of one module's method that decide what is reported: a ``table`` of a ``file`` of ``pipeline/``.

    Name, value, unit and reason of each stand in the file alone; a list is a tuple. No recipe changes them: they were
    chosen together, on data with a known answer. Raises RequestError where there is no such table.
    """

    def __init__(self, file: str, table: str) -> None:
        numbers = _tables(file).get(table)
        if numbers is None:
            raise RequestError("no such table", file=file, place=table)
        for name, value in numbers.items():
            self.__dict__[name] = tuple(value) if isinstance(value, list) else value

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"{name} is no number of {', '.join(self.__dict__)}")

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{name} stands in a file of pipeline/: it is not set")


BANDS = MethodNumbers("4-campbell-map.toml", "bands")


@cache
def _defaults() -> Mapping[str, Mapping[str, object]]:
    return {stage: table for file in Settings.file_of.values() for stage, table in _tables(file).items()}


def shipped(kind: str) -> dict[str, str]:
    """Names and texts of the TOML files of the folder ``kind`` of ``pipeline/``: "recipes", "engines" or "scenes"."""
    folder = files("crankorder.pipeline").joinpath(kind)
    texts = {item.name: item for item in folder.iterdir() if item.name.endswith(".toml")}
    return {name.removesuffix(".toml"): texts[name].read_text(encoding="utf-8") for name in sorted(texts)}


def toml_path(name: str, beside: Path | None = None) -> Path | None:
    """Path of the user's TOML file that ``name`` leads to, from the folder ``beside`` first where given; None if none.

    What cannot be the name of a file, being too long or holding a NUL, leads to none.
    """
    candidates = [Path(name)] if beside is None else [beside / name, beside / f"{name}.toml", Path(name)]
    # os.path.isfile: Path.is_file raises for a name that is too long
    return next((path for path in candidates if path.suffix == ".toml" and os.path.isfile(path)), None)  # noqa: PTH113


def toml_table(name: str, kind: str, *, beside: Path | None = None) -> tuple[dict[str, object], str]:
    """Table of a shipped or a user's TOML file, and the name by which errors call it.

    ``name`` is a shipped file's stem in the folder ``kind``, or the path of a TOML file (tried from ``beside`` first
    where given).
    Raises RequestError where no such file exists or its TOML is wrong (with line and column), ManyErrors with every
    number in it that is out of all proportion.
    """
    ours, found = shipped(kind), toml_path(name, beside)
    if found is None and name not in ours:
        allowed = f"{', '.join(ours) or 'none shipped'}, or a path of a .toml file"
        raise RequestError(f"no such {kind.removesuffix('s')}", found=name, allowed=allowed)
    source = f"{kind}/{name}.toml" if found is None else found.name
    try:
        table = tomllib.loads(ours[name] if found is None else found.read_text(encoding="utf-8"))
        faults = [] if kind == "recipes" else list(extremes(table, source))  # settings have ranges of their own
    except RecursionError:
        raise RequestError("not valid TOML: nested too deep", file=found or name) from None
    except ValueError as error:  # of TOML, of UTF-8, of a number with thousands of digits
        remedy = "Mend the line that it names"
        raise RequestError("not valid TOML", file=found or name, found=error, remedy=remedy) from None
    if faults:
        raise ManyErrors(faults)
    return table, source


def extremes(value: Any, source: str, place: str = "") -> Iterator[CrankorderError]:
    """A fault for each number in ``value``, a table or list of the file ``source``, that no machine and no test has.

    ``place``: key path of ``value`` in that file. Seeds may be any number.
    """
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, inner in items:
            yield from extremes(inner, source, f"{place}.{key}".lstrip("."))
        return
    number = isinstance(value, int) or (isinstance(value, float) and math.isfinite(value))
    if number and value and not LEAST <= abs(value) <= MOST and place.rpartition(".")[2] != "seed":
        allowed = f"0, or {LEAST:g} … {MOST:g} either way"
        yield RequestError("out of all proportion", file=source, place=place, found=value, allowed=allowed)


def load_settings(
    recipe: str | None = None, *, beside: Path | None = None, asked: Mapping[str, Mapping[str, object]] | None = None
) -> Settings:
    """Settings of all stages with the differences of ``recipe`` (a shipped name or a path of a TOML file) applied.

    A relative path is tried from the folder ``beside`` first. What the command or call ``asked`` for, by stage and key,
    goes before both; a value of None was not asked for.
    Raises ManyErrors that lists every unknown key and every value out of range, or RequestError for a missing file.
    """
    differences, source = ({}, "pipeline") if recipe is None else toml_table(recipe, "recipes", beside=beside)
    tables: dict[str, object] = dict(_defaults())
    options = {stage: {k: v for k, v in table.items() if v is not None} for stage, table in (asked or {}).items()}
    for stage, table in (*differences.items(), *options.items()):
        before = tables.get(stage, {})
        if isinstance(table, Mapping) and isinstance(before, Mapping):
            tables[stage] = {**before, **table}
        elif stage not in ("title", "description"):
            tables[stage] = table
    if any(options.values()):
        source = "the options"
    try:
        return Settings.model_validate(tables)
    except ValidationError as error:
        raise ManyErrors([validation_fault(fault, source) for fault in error.errors()]) from None


_ENCODER = "Remove it: an encoder is put right unasked, in teeth that err little too with --recipe calibrated-encoder"
_WIDTH = "Remove it: the bandwidth of an order that is followed through a sweep comes from the rate of the sweep"
_GONE = {
    "orders.method": "Remove it: orders are always resampled, within `tolerance`",
    "shaft.calibrate_encoder": _ENCODER,
    "shaft.calibration_speed_ratio": _ENCODER,
    "orders.track_bandwidth": _WIDTH,
    "orders.track_bandwidth_unit": _WIDTH,
}
"""Settings of earlier versions, and what to do instead."""


def validation_fault(fault: Any, source: str) -> RequestError:
    """RequestError with the key path of a pydantic ``fault`` in the file ``source``."""
    key = ".".join(str(part) for part in fault["loc"])
    unknown = fault["type"] == "extra_forbidden"
    if unknown and key in _GONE:
        return RequestError("no setting any more", file=source, place=key, remedy=_GONE[key])
    problem = "unknown key" if unknown else str(fault["msg"]).removeprefix("Value error, ")
    found = "" if unknown or fault["type"] == "missing" else fault["input"]
    remedy = "Remove it or mend its spelling" if unknown else ""
    return RequestError(problem, file=source, place=key, found=found, remedy=remedy)
