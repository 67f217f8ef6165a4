"""Runs the program on drawn machines and says whether it is right as often as before: ``make score``.

Repeats one of the three seed sets of the baseline, machine by machine, and adds fresh machines. The program is used as
a user does: its command, and the files that it writes. Exit status 1 where a class has fallen.
"""

import argparse
import multiprocessing
import os
import resource
import secrets
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import numpy as np  # noqa: E402

from machines.baseline import (  # noqa: E402  # after the number of threads is set
    PER_CLASS,
    SET_SEEDS,
    comparison_table,
    comparisons,
    fallen,
    host,
    is_of_this_scorer,
    read_baseline,
    write_baseline,
)
from machines.bound import bound_of  # noqa: E402
from machines.draw import CLASSES, draw_machine  # noqa: E402
from machines.folder import write_folder  # noqa: E402
from machines.judge import Judgement, Said, judged  # noqa: E402
from machines.table import DANGERS, SceneScore, table_text  # noqa: E402

FRESH = 60
"""Machines that nobody has seen before, in every run."""
LONGEST_CPU_S = 60
"""Processor seconds after which the program has failed on a machine."""
LONGEST_S = 240.0
"""Seconds after which a run of the program counts as hung."""


@dataclass(frozen=True)
class Scene:
    """What to draw: class and seed."""

    class_name: str
    seed: int


def drawn_scenes(count: int, seed: int) -> list[Scene]:
    """``count`` scenes of all classes in turn, with seeds that follow from ``seed``, the class and the turn."""
    scenes = []
    for number in range(count):
        turn, place = divmod(number, len(CLASSES))
        own = int(np.random.default_rng([seed, place, turn]).integers(1, 2**31))
        scenes.append(Scene(CLASSES[place], own))
    return scenes


def score_scene(scene: Scene, keep: Path | None = None) -> SceneScore:
    """Draw ``scene``, run the program on it, judge what it says; a crash is a result too.

    With ``keep`` the test and what the program wrote stay in a folder of its own there.
    """
    place = Path(tempfile.mkdtemp(prefix="machine_"))
    if keep is not None:
        place = keep / f"{scene.class_name.replace(' ', '-')}-{scene.seed}"
        shutil.rmtree(place, ignore_errors=True)
    spent = 0.0
    judgements: tuple[Judgement, ...] = ()
    try:
        machine = draw_machine(scene.class_name, scene.seed)
        takes = write_folder(machine, place / "test")
        bound, before = bound_of(machine), _cpu_of_children()
        message = run_program(place / "test", place / "out")
        spent = _cpu_of_children() - before
        if spent > LONGEST_CPU_S:
            message = f"{spent:.0f} processor seconds, {LONGEST_CPU_S} allowed"
        if not message and not any((place / "out").glob("*/findings.json")):
            message = "exit status 0, and no findings"
        if not message:
            judgements = judged(machine, takes, bound, Said.read(place / "out"))
    except Exception as error:  # the scorer's own fault must not end the campaign, and is listed as one
        message = f"scorer: {type(error).__name__}: {error}"
    finally:
        if keep is None:
            shutil.rmtree(place, ignore_errors=True)
    return SceneScore.of(scene.class_name, scene.seed, spent, message, judgements)


def _cpu_of_children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def run_program(folder: Path, out: Path) -> str:
    """Run the program's command on ``folder`` into ``out``, in a process of its own; "" or what went wrong.

    The process is forked after the program is loaded: loading takes longer than the analysis of a small test.
    """
    context = multiprocessing.get_context("fork")
    log = out.with_suffix(".log")
    child = context.Process(target=_command, args=(folder, out, log))
    child.start()
    child.join(LONGEST_S)
    if child.is_alive():
        os.killpg(child.pid or 0, signal.SIGKILL)  # its workers too
        child.join()
        return f"no answer in {LONGEST_S:g} s"
    if child.exitcode:
        said = log.read_text(encoding="utf-8", errors="replace").strip().splitlines() if log.exists() else []
        words = "; ".join(said[-3:]).replace(f"{folder.parent}{os.sep}", "")
        return f"exit status {child.exitcode}: {words[:400]}"
    return ""


def _command(folder: Path, out: Path, log: Path) -> None:
    os.setsid()
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_CPU_S + 1, LONGEST_CPU_S + 2))
    with log.open("w", encoding="utf-8") as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
        from crankorder.cli import main, run

        options = [name for option in run.params for name in option.opts]
        bare = ["--no-pictures"] if "--no-pictures" in options else []
        main(["run", str(folder), "--out", str(out), "--jobs", "1", *bare])


def _load_program() -> None:
    import crankorder.batch.execute
    import crankorder.batch.publish
    import crankorder.cli
    import crankorder.identify.findings  # noqa: F401


def score_scenes(scenes: list[Scene], *, jobs: int, keep: Path | None = None) -> list[SceneScore]:
    """Scores of ``scenes``, ``jobs`` at a time; each is told on stderr when done, its files kept in ``keep``."""
    _load_program()
    scores: list[SceneScore] = []
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("fork")) as pool:
        try:
            for score in pool.map(partial(score_scene, keep=keep), scenes):
                scores.append(score)
                state = score.message or f"{score.wrong:.1f} wrong, {score.cpu_s:.1f} s"
                place = f"{len(scores)}/{len(scenes)} {score.class_name} {score.seed}"
                print(f"{place}: {state}", file=sys.stderr, flush=True)
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise SystemExit("interrupted: nothing is said, nothing is written") from None
    return scores


def scenes_of_set(number: int) -> list[Scene]:
    """The scenes of the seed set ``number`` (1 to 3)."""
    return drawn_scenes(PER_CLASS * len(CLASSES), SET_SEEDS[number])


def make_baseline(jobs: int) -> int:
    """Score all three sets and write the baseline."""
    sets = {number: score_scenes(scenes_of_set(number), jobs=jobs) for number in SET_SEEDS}
    write_baseline(sets)
    return 0


def judge_change(number: int, count: int, seed: int, jobs: int) -> int:
    """Score the set ``number`` and ``count`` fresh machines of ``seed``, print what moved; 1 where something fell."""
    try:
        baseline, scenes = read_baseline(), scenes_of_set(number)
    except (ValueError, KeyError, TypeError) as error:
        print(f"reports/score.json is damaged ({error!r}): take it from the last commit")
        return 2
    if [Scene(score.class_name, score.seed) for score in baseline.get(number, [])] != scenes:
        print("reports/score.json holds no baseline of these machines: make one by `make score-baseline`")
        return 2
    if not is_of_this_scorer():
        print("The scorer is not that of the baseline: what moved may be its doing and not the program's.\n")
    # the fresh ones start with another class each time: their number need not be a multiple of the classes
    drawn = drawn_scenes(count + seed % len(CLASSES), seed)[seed % len(CLASSES) :]
    print(f"set {number} and {count} fresh machines of seed {seed}", file=sys.stderr, flush=True)
    scores = score_scenes([*scenes, *drawn], jobs=jobs)
    repeated, fresh = scores[: len(scenes)], scores[len(scenes) :]
    classes = comparisons(baseline[number], repeated)
    reasons = fallen(classes, [score for scores in baseline.values() for score in scores], fresh)
    print(f"# Score: set {number} beside its baseline\n\n{', '.join(host().values())}\n\n{comparison_table(classes)}")
    print(f"# {count} fresh machines, seed {seed}\n\n{table_text(fresh)}\n# Set {number}\n\n{table_text(repeated)}")
    dangers = [(score, *fault) for score in fresh for fault in score.faults if fault[0] in DANGERS]
    print("".join(f"LOOK: fresh {own.class_name} {own.seed}: {kind}: {words}\n" for own, kind, words in dangers))
    print("\n".join(f"FALLEN: {reason}" for reason in reasons) or "Nothing has fallen.")
    return int(bool(reasons))


def _whole(least: int) -> Callable[[str], int]:
    def number(text: str) -> int:
        if not text.isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r}: a whole number, {least} or more")
        return int(text)

    return number


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--set", type=int, choices=SET_SEEDS, help="the seed set to repeat; left out: by the fresh seed"
    )
    parser.add_argument("--fresh", type=_whole(0), default=FRESH, help="how many fresh machines")
    parser.add_argument("--seed", type=_whole(0), help="draws the same fresh machines again")
    parser.add_argument("--jobs", type=_whole(1), default=2, help="machines at a time")
    parser.add_argument("--baseline", action="store_true", help="score all three sets and keep them as the baseline")
    parser.add_argument("--classes", nargs="+", choices=CLASSES, help="with --machines: of these classes")
    parser.add_argument("--machines", type=_whole(0), nargs="+", help="these machines alone, by their own seeds")
    parser.add_argument("--keep", type=Path, help="with --machines: folder in which tests and results are kept")
    asked = parser.parse_args()
    if (asked.classes or asked.keep) and not asked.machines:
        parser.error("--classes and --keep go with --machines")
    if asked.baseline:
        return make_baseline(asked.jobs)
    if asked.machines:
        scenes = [Scene(name, seed) for name in asked.classes or CLASSES for seed in asked.machines]
        print(table_text(score_scenes(scenes, jobs=asked.jobs, keep=asked.keep)))
        return 0
    seed = secrets.randbits(31) if asked.seed is None else asked.seed
    return judge_change(asked.set or 1 + seed % len(SET_SEEDS), asked.fresh, seed, asked.jobs)


if __name__ == "__main__":
    sys.exit(main())
