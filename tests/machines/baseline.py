"""The committed baseline of the score: three seed sets, machine by machine, and what has fallen against it."""

import hashlib
import json
import platform
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from scipy.stats import binomtest

from machines.table import DANGERS, FOUND, INTERVALS, SceneScore, Share, by_class, share_of, table_text

REPORT = Path(__file__).resolve().parents[2] / "reports" / "score"
SET_SEEDS = {1: 37_001, 2: 37_002, 3: 37_003}
PER_CLASS = 13
"""Machines of a class in a set: with fewer than twelve a class could not fall even if all of them got worse."""
NEAR_LIMIT_S = 40.0
"""Processor seconds of a machine's baseline from which its running out of time is no fall."""
CHANCE = 0.01
"""Of a false alarm, over all classes together."""
SAME = 0.02
"""Of one statement: shares of a range change by so much where a limit moves by a few rpm."""


LEGEND = """`worse : better` counts machines (chance of luck, corrected: below 0.01 the class has fallen). In brackets
the baseline. wrong: statements that are not so; decided: of what an estimator that knows the model can decide; covered:
95 % intervals that hold the truth; width: of the intervals beside the baseline's, on average."""


@dataclass(frozen=True)
class Count:
    """Machines that got worse and better, and the chance of so many worse ones by luck, corrected (Holm)."""

    worse: int
    better: int
    chance: float = 1.0

    @property
    def text(self) -> str:
        """As the table shows it."""
        return f"{self.worse} : {self.better}" + (f" ({self.chance:.2g})" if self.worse > self.better else "")


@dataclass(frozen=True)
class Comparison:
    """One class beside its baseline: the same machines ``before`` and ``now``.

    ``right`` counts machines with more and with fewer wrong statements, ``decided`` those in which less and more is
    decided of what can be; a machine that fails is worse in both.
    """

    class_name: str
    before: list[SceneScore]
    now: list[SceneScore]
    right: Count
    decided: Count
    width: Count | None = None
    """Of all machines together: those whose intervals became wider and narrower."""

    @property
    def more(self) -> list[str]:
        """What a user would act on, and failures, of which there is more than before."""
        pairs = list(zip(self.before, self.now, strict=True))
        analysed = [pair for pair in pairs if not any(score.message for score in pair)]
        counts = [
            (kind, *(_misses(scores, kind) for scores in zip(*analysed, strict=True))) for kind in DANGERS if analysed
        ]
        words = [f"{kind}: {now:.0f}, before {before:.0f}" for kind, before, now in counts if now > before + 0.5]
        # where it was near the limit of time before, another load or processor decides
        failed = [
            now.seed
            for before, now in pairs
            if now.message and not before.message and min(before.cpu_s, now.cpu_s) < NEAR_LIMIT_S
        ]
        return words + ([f"failed, and did not before: {', '.join(map(str, failed))}"] if failed else [])


def comparisons(before: Sequence[SceneScore], now: Sequence[SceneScore]) -> list[Comparison]:
    """Each class of ``now`` and all of them together beside the same machines ``before``.

    One-sided sign tests of what is right and of what is decided, for all machines together also of the width of the
    intervals, machines that did not change left out; with Holm's correction (1979) over all of them.
    """
    known = {(score.class_name, score.seed): score for score in before}
    groups = [(name, [known[score.class_name, score.seed] for score in own], own) for name, own in by_class(now)]
    counts = [_counted(gain, old, own) for _, old, own in groups for gain in (_fewer_wrong, _more_decided)]
    counts.append(_counted(_narrower, *groups[-1][1:]))
    chances = holm([_chance(worse, worse + better, 0.5) for worse, better in counts])
    *tests, width = [Count(*count, chance) for count, chance in zip(counts, chances, strict=True)]
    classes = [
        Comparison(*group, right, decided)
        for group, right, decided in zip(groups, tests[::2], tests[1::2], strict=True)
    ]
    return [*classes[:-1], replace(classes[-1], width=width)]


def _counted(
    gain: Callable[[SceneScore, SceneScore], float], before: Sequence[SceneScore], now: Sequence[SceneScore]
) -> tuple[int, int]:
    """How many machines got worse and better by ``gain``."""
    gains = [gain(*pair) for pair in zip(before, now, strict=True)]
    return sum(one < -SAME for one in gains), sum(one > SAME for one in gains)


def _narrower(before: SceneScore, now: SceneScore) -> float:
    """By how much of their width the intervals became narrower, on geometric average."""
    return _mean(share_of([before], "log width")) - _mean(share_of([now], "log width"))


def _fewer_wrong(before: SceneScore, now: SceneScore) -> float:
    return _repaired(before, now) or before.wrong - now.wrong


def _more_decided(before: SceneScore, now: SceneScore) -> float:
    return _repaired(before, now) or now.decided - before.decided


def _repaired(before: SceneScore, now: SceneScore) -> float:
    return float(bool(before.message)) - float(bool(now.message))


def _chance(count: int, of: int, share: float) -> float:
    return float(binomtest(count, of, share, alternative="greater").pvalue) if count else 1.0


def scorer_digest() -> str:
    """Digest of the code that draws and judges: with another one what moves may be its doing."""
    names = ("bound", "draw", "folder", "judge", "lines", "machine", "signals", "tracks", "truth")
    text = b"".join(Path(__file__).with_name(f"{name}.py").read_bytes() for name in names)
    return hashlib.sha256(text).hexdigest()[:16]


def holm(chances: Sequence[float]) -> list[float]:
    """Chances of several tests, corrected for their number (Holm 1979): each may be held against the level itself."""
    order = np.argsort(chances)
    corrected = np.maximum.accumulate([chances[at] * (len(order) - rank) for rank, at in enumerate(order)])
    result = np.empty(len(order))
    result[order] = np.minimum(corrected, 1.0)
    return [float(chance) for chance in result]


def fallen(classes: Iterable[Comparison], baseline: Sequence[SceneScore], fresh: Sequence[SceneScore]) -> list[str]:
    """Why the change is not good, in words; empty where it is.

    ``classes``: the repeated set beside its baseline. ``fresh`` machines have none: of them more may not fail, or hold
    something that a user would act on, than the share in the whole ``baseline`` makes likely (1 %).
    """
    reasons = []
    for own in classes:
        for what, count in (("wrong", own.right), ("decided", own.decided), ("width of intervals", own.width)):
            if count is not None and count.chance < CHANCE:
                numbers = f"{count.worse} machines worse, {count.better} better (chance {count.chance:.2g})"
                reasons.append(f"{own.class_name}: {what}: {numbers}")
        reasons += [f"{own.class_name}: {words}" for words in own.more if own.class_name != "all"]
    counts = {
        kind: tuple(sum(score.misses(kind) > 0.5 for score in scores) for scores in (baseline, fresh))
        for kind in DANGERS
    } | {"failed": tuple(sum(bool(score.message) for score in scores) for scores in (baseline, fresh))}
    part = len(fresh) / max(1, len(fresh) + len(baseline))
    chances = [_chance(new, old + new, part) for old, new in counts.values()]
    for (kind, (old, new)), chance in zip(counts.items(), holm(chances), strict=True):
        if chance < CHANCE:
            words = f"{new} of {len(fresh)} machines, in the baseline {old} of {len(baseline)} (chance {chance:.2g})"
            reasons.append(f"fresh machines, {kind}: {words}")
    return reasons


def _misses(scores: Iterable[SceneScore], kind: str) -> float:
    return sum(score.misses(kind) for score in scores)


def comparison_table(classes: Sequence[Comparison]) -> str:
    """The comparisons as Markdown, what was decided beside what was right, and the machines that moved.

    The baseline's numbers stand in brackets; the last of ``classes`` is that of all machines.
    """
    head = (
        "class", "machines", "wrong: worse : better", "decided: worse : better", "wrong", "decided, %", "covered, %",
        "width", *DANGERS, "failed", "cpu s",
    )  # fmt: skip
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for own in classes:
        pair = (own.now, own.before)
        widths = [share_of(scores, "log width") for scores in pair]
        cells = [
            own.class_name, str(len(own.now)), own.right.text, own.decided.text,
            _beside(*(f"{sum(score.wrong for score in scores):.1f}" for scores in pair)),
            _beside(*(f"{100.0 * share_of(scores, *FOUND).share:.1f}" for scores in pair)),
            _beside(*(f"{100.0 * share_of(scores, *INTERVALS).share:.1f}" for scores in pair)),
            f"{100.0 * np.expm1(round(_mean(widths[0]) - _mean(widths[1]), 4) + 0.0):+.1f} %",
            *(_beside(*(f"{_misses(scores, kind):.0f}" for scores in pair)) for kind in DANGERS),
            _beside(*(f"{sum(bool(score.message) for score in scores)}" for scores in pair)),
            _beside(*(f"{np.mean([score.cpu_s for score in scores]):.1f}" for scores in pair)),
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, "", LEGEND, "", *_moved(classes[-1])]) + "\n"


def _moved(own: Comparison) -> list[str]:
    """Machines of a comparison that moved, those with more wrong statements first."""
    pairs = [
        pair
        for pair in zip(own.before, own.now, strict=True)
        if max(abs(_fewer_wrong(*pair)), abs(_more_decided(*pair))) > SAME
    ]
    return [
        f"* {now.class_name} {now.seed}: wrong {before.wrong:.1f} → {now.wrong:.1f}, "
        f"decided {before.decided:.2f} → {now.decided:.2f}{'; ' + now.message if now.message else ''}"
        for before, now in sorted(pairs, key=lambda pair: _fewer_wrong(*pair))
    ]


def _beside(now: str, before: str) -> str:
    return f"{now} ({before})"


def _mean(share: Share) -> float:
    return share.good / share.of if share.of else 0.0


def _report() -> dict[str, Any]:
    path = REPORT.with_suffix(".json")
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else {}


def is_of_this_scorer() -> bool:
    """Whether the code that draws and judges is that of the committed baseline."""
    return bool(_report().get("scorer") == scorer_digest())


def read_baseline() -> dict[int, list[SceneScore]]:
    """Scores of the committed baseline, by set; empty where there is none."""
    plain = _report()
    return {
        int(number): [SceneScore.read(score) for score in scores] for number, scores in plain.get("sets", {}).items()
    }


def write_baseline(sets: dict[int, list[SceneScore]]) -> None:
    """Write the baseline of all ``sets`` into ``reports/score.json`` and ``.md``."""
    scores = [score for number in sorted(sets) for score in sets[number]]
    lines = [
        f' "{number}": [\n' + ",\n".join(f"  {json.dumps(s.plain())}" for s in sets[number]) + "\n ]"
        for number in sorted(sets)
    ]
    text = (
        f'{{"host": {json.dumps(host())},\n"scorer": "{scorer_digest()}",\n"sets": {{\n' + ",\n".join(lines) + "\n}}\n"
    )
    REPORT.with_suffix(".json").write_text(text, encoding="utf-8")
    machines = [
        f"| {number} | {score.class_name} | {score.seed} | {score.wrong:.1f} | {score.decided:.2f} | "
        f"{score.misses(*DANGERS):.0f} | {score.cpu_s:.1f} | {score.message} |"
        for number in sorted(sets)
        for score in sets[number]
    ]
    REPORT.with_suffix(".md").write_text(
        f"""# Score: drawn machines through the whole program

Baseline of the three seed sets of `make score`, which says where a change falls against it. Truth is that of
`tests/machines`, which shares nothing with the program. {", ".join(host().values())}.

{table_text(scores)}
## Machine by machine

Dangers: dangerous speeds called free, locks told wrong, parts made up. Seconds are those of one processor.

| set | class | seed | wrong | decided | dangers | s | failed |
|---|---|---|---|---|---|---|---|
"""
        + "\n".join(machines)
        + "\n",
        encoding="utf-8",
    )


def host() -> dict[str, str]:
    """Processor and versions of this run: another processor may round a machine across a limit."""
    info = Path("/proc/cpuinfo")
    named = re.search(r"^model name\s*:\s*(.+)$", info.read_text(), re.MULTILINE) if info.exists() else None
    return {
        "processor": named[1] if named else platform.processor() or platform.machine(),
        "python": f"Python {platform.python_version()}",
        "numpy": f"numpy {np.__version__}",
        "scipy": f"scipy {scipy.__version__}",
    }
