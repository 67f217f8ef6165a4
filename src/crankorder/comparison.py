"""A comparison of tests as types: what differs between two, or changes over the runs of one, and how sure that is.

Every estimate ``x`` has ``x_ci95``; None stands for not known. Units stand in the names. The schema
``data_schema/comparison.json`` is made from these types, and the file ``comparison.json`` is their ``as_dict``.
"""

from __future__ import annotations

from typing import Literal

from crankorder.findings import TrialBalance
from crankorder.records import ABSENT, Ends, Interval, Record, known, said

SCHEMA_VERSION = 1
"""Of ``comparison.json``."""

Cause = Literal[
    "nothing changed", "unbalance", "moving masses", "orders", "growing line", "natural frequencies", "gain",
    "not comparable",
]  # fmt: skip

Severity = Literal["invalid", "weakens", "harmless"]
"""What a confound does to a comparison: nothing can be compared, claims need care, or none."""

Part = Literal["all", "orders", "phases", "channel"]
"""What of the comparison a confound concerns."""

FIRING = "firing or motoring"
"""Confound: one test was fired, the other motored."""

REPEATS = "repeats"
"""Confound: not both tests were repeated at a speed."""

PROGRAM = "program"
"""Confound: other versions of the program analysed them."""

LineKind = Literal["order", "bearing", "bearing, envelope"]
"""What is followed from run to run: an order, a bearing line, or one in the envelope."""


class Explanation(Record):
    """What explains the changes."""

    cause: Cause = said("in one word or two")
    orders: tuple[float, ...] = said(
        "orders that changed by more than natural frequencies that moved explain, or of the lines that grow from run "
        "to run"
    )
    besides: Cause | None = said(
        "what explains orders that changed besides natural frequencies; null without such", default=None
    )


class SpeedPair(Record):
    """Speeds of the two tests that were compared with one another."""

    base_rpm: float | None = said("in the first test")
    new_rpm: float | None = said("in the second test")


class ChannelCompared(Record):
    """A channel of either test, and whether it was compared."""

    name: str = said("name")
    unit: str = said("its unit")
    compared: bool = said("whether it was compared")
    reason: str = said("why it was not compared; else empty")
    gain: float | None = said(
        "second test over first where the channel reads all orders by one factor more or less at all speeds, and no "
        "other channel changed: its sensor or gain; null else",
        default=None,
    )
    gain_ci95: Interval | None = said(default=None)


class OrderChangeRecord(Record):
    """Change of one order in one channel."""

    channel: str = said("name of the channel")
    order: float = said("cycles per crank revolution")
    unit: str = said("unit of the amplitudes")
    locked: bool = said("compared by its coherent amplitude and phase; else by its energy")
    explained_by: str | None = said("what makes it, as the findings say")
    changed: bool = said("whether a change is claimed")
    phase_only: bool = said("claimed of amplitude and phase together, and not of the amplitude alone: the phase turned")
    p_value: float = said("chance of so large a change where nothing changed, over all speeds")
    ratio: float | None = said("second amplitude over first, mean of the speeds at which both are clear of the noise")
    ratio_ci95: Interval = said()
    ratio_db: float | None = said("the same in dB")
    ratio_db_ci95: Interval = said()
    alike_p: float | None = said("chance of ratios that differ so much between speeds where they are all alike")
    speed_rpm: float | None = said("speed of the clearest change, to which the amplitudes belong")
    base_amplitude: float = said("peak amplitude in the first test")
    new_amplitude: float = said("peak amplitude in the second test")
    difference: float = said("second amplitude less first")
    difference_ci95: Interval = said()
    n_speeds: int = said("speeds that were compared")
    n_changed: int = said("speeds at which a change is claimed")
    by_modes_hz: tuple[float, ...] = said(
        "natural frequencies whose shift may be all of the change that is claimed", default=()
    )
    undecided_rpm: tuple[float, ...] = said(
        "speeds at which lines beside it, such as mains, may hide a change; none is claimed there", default=()
    )
    hidden_by: str | None = said(
        "what lines of one frequency these are, as the findings say; null for other lines", default=None
    )


class ModeShift(Record):
    """A natural frequency of both tests and how it moved, or of one test alone."""

    only_in: Literal["base", "new"] | None = said("the test that alone shows it (no claim); null where both do")
    frequency_hz: float = said("natural frequency in the first test that shows it")
    new_frequency_hz: float | None = said("in the second test, where both show it", default=ABSENT)
    shift_hz: float | None = said("second frequency less first", default=ABSENT)
    shift_hz_ci95: Interval | None = said(default=ABSENT)
    damping_change: float | None = said("second damping ratio less first", default=ABSENT)
    damping_change_ci95: Interval | None = said(default=ABSENT)
    p_value: float | None = said("chance of so large a change where nothing changed")
    changed: bool = said("whether a change is claimed", default=False)

    @property
    def moved(self) -> bool:
        """Whether a shift is claimed, rather than a change of damping alone."""
        ends = known(self.shift_hz_ci95)
        return self.changed and ends is not None and not ends[0] <= 0 <= ends[1]


class UnbalanceRecord(Record):
    """What became of the unbalance that an order shows in a channel."""

    channel: str = said("name of the channel")
    order: float = said("1 or 2")
    unit: str = said("unit of the channel")
    changed: bool = said("whether the order changed")
    explains: bool = said("the order changed, and one factor of unbalance fits at all speeds and is not 1")
    factor: float = said("unbalance after over before: one factor at all speeds, whatever the path to the sensor")
    factor_ci95: Ends = said()
    turned_deg: float | None = said("angle by which it turned; null where that is not known")
    turned_deg_ci95: Interval | None = said()
    one_factor_p: float | None = said("chance of a worse fit of one factor; null for one speed")
    square_law_amplitude: float = said("change at reference_rpm where it grows with the square of speed at one phase")
    square_law_amplitude_ci95: Interval = said()
    square_law_phase_deg: float = said("its phase")
    square_law_p: float | None = said("chance of a worse fit of the square law; null for one speed")
    reference_rpm: float = said("the fastest speed")
    n_speeds: int = said("speeds with phases in both tests")


class BalanceChange(Record):
    """Change of a mass of the closed balance."""

    quantity: str = said("its name among the findings on the balance")
    base: float = said("in the first test, in g or g·mm as its name says")
    new: float = said("in the second test")
    change: float = said("second less first")
    change_ci95: Interval = said()
    changed: bool = said("whether the interval excludes 0")
    by_ratio_of_orders: tuple[float, ...] = said(
        "orders whose ratio in the two tests tells one mass from the other; empty: both closed, and subtracted"
    )


class Trend(Record):
    """A line over the runs."""

    line: str = said("its name")
    kind: LineKind = said("an order, a bearing line, or one in the envelope")
    channel: str = said("empty: of all channels together, as shares of the mean")
    order: float = said("cycles per crank revolution")
    amplitude: tuple[float, ...] = said("peak amplitude by run")
    amplitude_ci95: tuple[Interval, ...] = said("95 % interval of amplitude by run: low, high")
    growth_per_run: float = said("share by which it grows from run to run")
    growth_per_run_ci95: Ends = said()
    p_value: float = said("chance of so large a trend where there is none")
    verdict: str = said("what that means, in words", default="")
    changed: bool = said("whether growth or fall is claimed", default=False)

    @property
    def grows(self) -> bool:
        """Whether growth is claimed."""
        return self.changed and self.growth_per_run > 0


class Confound(Record):
    """A difference of how two tests were made."""

    what: str = said("what differs")
    severity: Severity = said("nothing can be compared, claims need care, or none")
    part: Part = said("what of the comparison is concerned")
    channel: str = said("name of the channel, where one is concerned; else empty")
    base: str = said("value in the first test")
    new: str = said("value in the second test")
    words: str = said("what it does to the comparison")


class Comparison(Record):
    """What differs between two tests, or changes over the runs of one."""

    schema_version: int = said("version of this schema", least=1)
    base: str = said("name of the first test")
    new: str = said("name of the test that is compared with it: the last run")
    runs: tuple[str, ...] = said("names of all tests, in time order")
    false_discovery_rate: float = said(
        "share of the claimed changes (changed: true) that may be chance; over orders, modes and trends, each"
    )
    headline: tuple[str, ...] = said("what matters most, in sentences")
    cause: Explanation = said(
        'what explains the changes; "nothing changed" is said of the orders, natural frequencies and bearing lines '
        "that were compared, and of nothing else"
    )
    speeds: tuple[SpeedPair, ...] = said("speeds that were compared with one another")
    channels: tuple[ChannelCompared, ...] = said("channels of both tests")
    orders: tuple[OrderChangeRecord, ...] = said("change of every order that either test shows, and of orders 1 and 2")
    modes: tuple[ModeShift, ...] = said("natural frequencies of both tests")
    unbalance: tuple[UnbalanceRecord, ...] = said("what became of the unbalance that orders 1 and 2 show")
    trial_mass: TrialBalance | None = said(
        "residual unbalance before and after the change of mass that the manifests state, of all channels and speeds "
        "together: the record balance of findings.json with residual_after_*; null where none is stated or it cannot "
        "be told"
    )
    trial_mass_reason: str = said("why a stated change of mass tells nothing; empty where it does or none is stated")
    balance: tuple[BalanceChange, ...] = said(
        "change of the mass behind orders 1 and 2, from the balance that was closed with the engine model in both "
        "findings, or in one of them and the ratio of the orders"
    )
    balance_reason: str = said("why neither test closed its balance; empty where one did")
    trend: tuple[Trend, ...] = said("lines over the runs: bearing lines of two or more, orders of three or more")
    confounds: tuple[Confound, ...] = said("what else than the machine differs")

    @property
    def comparable(self) -> bool:
        """Whether the tests have anything in common that could be compared."""
        return self.cause.cause != "not comparable"


class BuildComparison(Record):
    """What differs between two builds, each of several tests."""

    schema_version: int = said("version of this schema", least=1)
    base: str = said("name of the folder of the first build")
    new: str = said("name of the folder of the second build")
    headline: tuple[str, ...] = said("what changed over all tests, in sentences")
    tests: tuple[Comparison, ...] = said("comparison of each test of the first build with its partner in the second")
    alone: tuple[str, ...] = said("tests without a partner, which were not compared, with the folder of their build")

    @property
    def comparable(self) -> bool:
        """Whether any two tests have anything in common that could be compared."""
        return any(test.comparable for test in self.tests)

    @property
    def confounds(self) -> tuple[Confound, ...]:
        """What else than the machine differs in any two tests, each once."""
        return tuple(dict.fromkeys(confound for test in self.tests for confound in test.confounds))
