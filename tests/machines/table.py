"""The table of a campaign: how often each kind of statement was right, by class and in all, and what was decided."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from machines.judge import Judgement

MARKS = ("dangerous not free", "lock", "strongest", "mode found", "mode real", "part real", "rows", "consistent")
"""Kinds whose every miss is a fault."""
DANGERS = ("dangerous not free", "lock", "part real")
"""Kinds whose misses may not become more: what a user would act on."""
INTERVALS = ("amplitude", "phase", "frequency", "damping")
DECIDED = ("decided: free", "decided: lock", "decided: mode")
MORE = (
    "dangerous range not free", "dangerous named", "order found", "order real", "amplitude, transient",
    "amplitude, steady",
)  # fmt: skip
WRONG = {
    **dict.fromkeys((*DANGERS, "strongest", "mode real", "consistent", "order real"), 1.0),
    "dangerous range not free": 1.0,
    "rows": 0.1,
}
"""Kinds of which a miss is a wrong statement, and its weight: a track has many rows."""
FOUND = (*DECIDED, "mode found", "order found", "dangerous named")
"""Kinds that say how much of what can be known was said."""
WORST = 12
"""Words per kind that the list of faults holds."""


@dataclass(frozen=True)
class Share:
    """How much of a kind was good: ``good`` of ``of``."""

    good: float
    of: float

    @property
    def share(self) -> float:
        """Between 0 and 1; 1 where nothing was asked."""
        return self.good / self.of if self.of else 1.0

    @property
    def misses(self) -> float:
        """What was not good."""
        return self.of - self.good

    def text(self, *, misses: bool) -> str:
        """As the table shows it: misses of how many, or the share in per cent of how many."""
        if not self.of:
            return "–"
        if misses:
            return f"{self.misses:.0f} / {self.of:.0f}"
        return f"{100.0 * self.share:.1f} ({self.of:.0f})"


@dataclass(frozen=True)
class SceneScore:
    """One machine: class and seed, processor seconds of the program, how it failed (""), and its shares by kind.

    ``faults``: kind and words of every statement that was not good.
    """

    class_name: str
    seed: int
    cpu_s: float
    message: str
    shares: dict[str, Share]
    faults: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, class_name: str, seed: int, cpu_s: float, message: str, judgements: Iterable[Judgement]) -> SceneScore:
        """The score that ``judgements`` give a machine."""
        shares: dict[str, Share] = {}
        faults = []
        for judgement in judgements:
            before = shares.get(judgement.kind, Share(0.0, 0.0))
            shares[judgement.kind] = Share(before.good + judgement.good, before.of + judgement.of)
            if judgement.good < judgement.of:
                faults.append((judgement.kind, judgement.words))
        return cls(class_name, seed, cpu_s, message, shares, tuple(faults))

    def plain(self) -> dict[str, Any]:
        """As JSON holds it, without the words."""
        shares = {kind: [round(share.good, 4), round(share.of, 4)] for kind, share in sorted(self.shares.items())}
        plain = {"class": self.class_name, "seed": self.seed, "cpu_s": round(self.cpu_s, 2), "message": self.message}
        return plain | {"shares": shares}

    @classmethod
    def read(cls, plain: dict[str, Any]) -> SceneScore:
        """The score that :meth:`plain` gave."""
        shares = {kind: Share(*numbers) for kind, numbers in plain["shares"].items()}
        return cls(plain["class"], plain["seed"], plain["cpu_s"], plain["message"], shares)

    def misses(self, *kinds: str) -> float:
        """Statements of ``kinds`` that were not good."""
        return sum(self.shares[kind].misses for kind in kinds if kind in self.shares)

    @property
    def wrong(self) -> float:
        """Wrong statements, weighted; of 95 % intervals those that miss beyond one in twenty."""
        intervals = share_of([self], *INTERVALS)
        wrong = sum(weight * self.misses(kind) for kind, weight in WRONG.items())
        return wrong + max(0.0, intervals.misses - 0.05 * intervals.of)

    @property
    def decided(self) -> float:
        """What was found or decided of what can be, as a sum over all."""
        return sum(self.shares[kind].good for kind in FOUND if kind in self.shares)


def share_of(scores: Iterable[SceneScore], *kinds: str) -> Share:
    """Share of all ``kinds`` pooled over ``scores``."""
    shares = [score.shares[kind] for score in scores for kind in kinds if kind in score.shares]
    return Share(sum(share.good for share in shares), sum(share.of for share in shares))


def by_class(scores: Sequence[SceneScore]) -> list[tuple[str, list[SceneScore]]]:
    """``scores`` by class, in the order in which these come, and "all"."""
    names = dict.fromkeys(score.class_name for score in scores)
    groups = [(name, [score for score in scores if score.class_name == name]) for name in names]
    return [*groups, ("all", list(scores))]


def table_text(scores: Sequence[SceneScore]) -> str:
    """The ``scores`` as Markdown: wrong statements, what was decided beside them, coverage, the rest, and faults."""
    groups = by_class(scores)
    failed = sum(bool(score.message) for score in scores)
    seconds = sum(score.cpu_s for score in scores) / max(1, len(scores))
    lines = [
        f"{len(scores)} machines; {failed} failed; {seconds:.1f} processor seconds each for the program.", "",
        "Wrong statements / statements:", "", *_table(groups, MARKS, misses=True), "",
        "Decided, % of what an estimator that knows the model decides:", "", *_table(groups, DECIDED, misses=False), "",
        "95 % intervals that cover, % (intervals):", "", *_table(groups, (*INTERVALS, "pooled"), misses=False), "",
        "More, %:", "", *_table(groups, MORE, misses=False), "", *_faults(scores),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _table(groups: list[tuple[str, list[SceneScore]]], kinds: tuple[str, ...], *, misses: bool) -> list[str]:
    lines = ["| class | machines | " + " | ".join(kinds) + " |", "|---" * (len(kinds) + 2) + "|"]
    for name, own in groups:
        shares = [share_of(own, *(INTERVALS if kind == "pooled" else (kind,))) for kind in kinds]
        cells = [share.text(misses=misses) for share in shares]
        lines.append(f"| {name} | {len(own)} | " + " | ".join(cells) + " |")
    return lines


def _faults(scores: Sequence[SceneScore]) -> list[str]:
    """Failures of the program, then some wrong statements of every kind, each with its class and seed."""
    lines = [f"* failed: {score.class_name} {score.seed}: {score.message}" for score in scores if score.message]
    for kind in (*MARKS, *INTERVALS):
        by_scene: dict[tuple[str, int], str] = {}
        for score in scores:
            for words in (words for own, words in score.faults if own == kind):
                by_scene.setdefault((score.class_name, score.seed), words)
        lines += [f"* {kind}: {name} {seed}: {words}" for (name, seed), words in list(by_scene.items())[:WORST]]
    return [*lines, ""] if lines else []
