"""The command line. Heavy imports wait until a command needs them; stdout is data only, everything else is stderr."""

from __future__ import annotations

import atexit
import contextlib
import gc
import io
import os
import shutil
import signal
import stat
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from crankorder.errors import CrankorderError, EnvironmentFailure, printable

if TYPE_CHECKING:
    from crankorder.batch.plan import Outcome, RunOptions
    from crankorder.batch.publish import ReportingProcess

ReportOptions = Mapping[str, object]
FOLDER = click.Path(path_type=Path)
DEMO_SCENE = "thesis-second-motoring"
MOST_CHARACTERS = 20_000  # of a line
MAX_SPEED_RPM = 1e6  # beyond any crankshaft; a typing error, not an engine


class Guarded(click.Group):
    """A group whose commands end with the documented exit status and one clear line for every known fault."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run a command line: ``args`` and ``kwargs`` are click's. A stream that was closed leads to nowhere."""
        _open_streams()
        # before numpy loads: recordings run side by side, and threads that wait for small products burn the processor
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        with _guarded():
            return super().main(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command of ``ctx``."""
        with _guarded():
            return super().invoke(ctx)


@contextlib.contextmanager
def _guarded() -> Iterator[None]:
    """Known faults become one line on stderr and an exit status."""
    try:
        yield
    except CrankorderError as error:
        _fail(str(error), error.exit_status)
    except KeyboardInterrupt:
        _fail("interrupted; run the same command again: an analysis keeps its finished tests", 130)
    except PermissionError as error:
        _fail(f"{error.filename}: no permission. Choose another folder or change its rights.", 5)
    except MemoryError:
        _fail("not enough memory; analyse fewer recordings at a time (--jobs 1)", 5)
    except BrokenPipeError:
        raise  # click ends quietly where nobody reads on
    except OSError as error:
        with contextlib.suppress(OSError, ValueError):  # what still waits for stdout could not be written either
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        where = "standard output" if error.filename is None else error.filename
        _fail(f"{where}: {error.strerror or error}. Free space, or choose another place.", 5)
    except RuntimeError as error:
        if "ymlink loop" not in str(error):  # pathlib's words, up to Python 3.12
            raise
        _fail(f"{error}: a link that leads to itself. Give the folder that it should lead to.", 2)


def _fail(message: str, status: int) -> NoReturn:
    _tell(*f"crankorder: {message}".split("\n"))
    sys.exit(status)


def _tell(*lines: object, err: bool = True) -> None:
    """Print ``lines``, which may quote names of any characters, on stderr, or on stdout unless ``err``."""
    for line in lines:
        click.echo(printable(line, MOST_CHARACTERS), err=err)


def _open_streams() -> None:
    """Open the null device for each standard stream that was closed: else the next file opened would pass for it."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            if os.open(os.devnull, os.O_RDWR) == number:
                setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115
    if (stream := sys.__stderr__) is not None and sys.stderr is stream:
        unbuffered = open(2, "wb", buffering=0, closefd=False)  # noqa: SIM115
        sys.stderr = _Remarks(unbuffered, stream.encoding, "backslashreplace", write_through=True)


class _Remarks(io.TextIOWrapper):
    """Standard error where a remark that cannot be written, as on a full disk, is lost: the work goes on."""

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            super().write(text)
        return len(text)


def _terminated(signum: int, frame: object) -> NoReturn:
    raise SystemExit(128 + signum)


def keep_compiled_kernels() -> None:
    """Give numba a folder for its compiled kernels where neither the package's nor the user's can be written.

    Kernels are pickles, which run what they hold: only a folder that is ours alone will do. Where there is none they
    are compiled again in each run.
    """
    package = Path(__file__).parent
    if "NUMBA_CACHE_DIR" in os.environ or os.access(package, os.W_OK) or _user_cache_can_be_written():
        return
    chosen = Path(tempfile.gettempdir()) / f"crankorder-kernels-{os.getuid()}"
    try:
        chosen.mkdir(mode=0o700, exist_ok=True)
        found = chosen.lstat()
        private = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    except OSError:
        private = False
    if not private:
        chosen = Path(tempfile.mkdtemp(prefix="crankorder-kernels-"))
        atexit.register(shutil.rmtree, chosen, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(chosen)


def _user_cache_can_be_written() -> bool:
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~").expanduser() / ".cache")
        existing = next(folder for folder in (home, *home.parents) if folder.exists())
    except (RuntimeError, OSError, StopIteration):  # a user without a home
        return False
    return os.access(existing, os.W_OK)


@click.group(cls=Guarded, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="crankorder", prog_name="crankorder")
def main() -> None:
    """Order tracking and vibration analysis for engines and other rotating machines.

    First look: `crankorder demo --quick`. Own data: `crankorder init FOLDER`, edit FOLDER/run.toml, then
    `crankorder run FOLDER --out OUT`.
    """
    signal.signal(signal.SIGTERM, _terminated)
    keep_compiled_kernels()


CORES, ALL = os.cpu_count() or 1, "all cores"
_jobs = click.option("--jobs", type=click.IntRange(1), default=CORES, show_default=ALL, help="Recordings at a time.")
_folders = click.argument("folders", nargs=-1, required=True, type=FOLDER, metavar="FOLDER...")
_manifest = click.option("--manifest", type=FOLDER, help="A run.toml that lives elsewhere than the data.")
_as_json = click.option("--json", "as_json", is_flag=True, help="One JSON document on stdout.")
_quiet = click.option("-q", "--quiet", is_flag=True, help="Only faults.")
_verbose = click.option("-v", "--verbose", is_flag=True, help="Also flags, timings, tracebacks.")


def _run_options(command: Callable[..., Any]) -> Callable[..., Any]:
    return _jobs(_as_json(_quiet(_verbose(command))))


def _picture_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``command`` with the options on pictures, which it takes as ``report``, settings by key."""

    @wraps(command)
    def with_report(*given: Any, picture_format: str | None, no_pictures: bool, **options: Any) -> Any:
        report = {} if picture_format is None else {"picture_format": picture_format}
        return command(*given, report=report | ({"pictures": False} if no_pictures else {}), **options)

    kinds = click.Choice(["png", "svg", "pdf"])
    with_report = click.option("--no-pictures", is_flag=True, help="Numbers and findings alone.")(with_report)
    return click.option("--picture-format", type=kinds, help="Format of the pictures.  [default: png]")(with_report)


@main.command()
@_folders
@click.option("--out", required=True, type=FOLDER, help="Folder for the results; made if missing.")
@_manifest
@click.option("--name", help="Name of the test and of its folder in OUT; goes before that of the manifest.")
@click.option("--recipe", help="A shipped recipe or the path of one; goes before that of the manifest.")
@click.option(
    "--tol", "tolerance", type=float,
    help="Relative amplitude error that the numerics may add, 1e-12 to 0.1: the cheapest method that meets it.",
)  # fmt: skip
@click.option(
    "--max-memory", "max_memory_mb", type=click.IntRange(0), metavar="MB",
    help="Memory for the samples of one recording; a larger one is streamed through a file in TMPDIR or /var/tmp.",
)  # fmt: skip
@click.option("--fresh", is_flag=True, help="Recompute even what is finished and unchanged.")
@click.option("--dry-run", is_flag=True, help="Say what would be done; write nothing.")
@click.option(
    "--shard", metavar="K/N", help="Analyse every N-th recording from the K-th on, and keep what they give in OUT."
)
@click.option("--reduce", is_flag=True, help="Make the results of what shards have kept; what is missing is analysed.")
@click.option(
    "--timeout", "timeout_s", type=click.FloatRange(0, min_open=True), help="Seconds that a recording may take."
)
@click.option(
    "--scheduler", metavar="ADDRESS", help="Analyse recordings on a Dask cluster, such as tcp://host:8786 (extra dist)."
)
@click.option(
    "--keep-frames", "keep_mb", type=click.FloatRange(0), default=2000, show_default=True, metavar="MB",
    help="Most that is kept in OUT of these recordings, so that a further run need not compute them; 0 keeps nothing.",
)  # fmt: skip
@click.option("--log-json", is_flag=True, help="The log in OUT/.crankorder-logs as JSON lines.")
@click.option("--strict", is_flag=True, help='Leave out recordings with flags of severity "suspect".')
@_picture_options
@_run_options
def run(
    folders: tuple[Path, ...],
    out: Path,
    fresh: bool,
    dry_run: bool,
    shard: str | None,
    reduce: bool,
    timeout_s: float | None,
    scheduler: str | None,
    keep_mb: float,
    log_json: bool,
    strict: bool,
    jobs: int,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **asked: Any,
) -> None:
    """Analyse test-run folders.

    One machine: `crankorder run FOLDER --out OUT`. Many: the same with `--shard 1/8` to `--shard 8/8`, each wherever it
    runs, with one OUT; then once with `--reduce`.
    """
    from crankorder.batch.plan import RunOptions, plan_tests, share_of

    if scheduler is not None and (shard is not None or timeout_s is not None):
        raise click.UsageError("--scheduler shares recordings out itself, and ends none: not with --shard or --timeout")
    if shard is not None and reduce:
        raise click.UsageError("--shard keeps what recordings give, --reduce makes the results of it: not both at once")

    planned = plan_tests(list(folders), out, **asked)
    plans = planned.tests if shard is None else [share_of(plan, shard) for plan in planned.tests]
    for fault in planned.refused:
        _tell(f"crankorder: not analysed: {fault}")
    if dry_run:
        for plan in plans:
            size = sum(path.stat().st_size for path in plan.recordings)
            _tell(f"{plan.name}: {len(plan.recordings)} recordings, {size / 1e6:.0f} MB -> {plan.out}", err=False)
            _tell(*(f"  {fault}" for fault in plan.faults))
        sys.exit(3 if planned.refused else 0)
    options = RunOptions(
        jobs=jobs, fresh=fresh and not reduce, strict=strict, timeout_s=timeout_s, keep_only=shard is not None,
        scheduler=scheduler,
    )  # fmt: skip
    from crankorder.batch.run_log import logged, tell

    with logged(out, as_json=log_json):
        tell("run begun", out=out, tests=len(plans), shard=shard, **vars(options))
        for fault in planned.refused:
            tell("not analysed", why=fault)
        status = _run_plans(plans, out, options, as_json, quiet, verbose)
        if shard is None:
            _prune(plans, out, keep_mb, quiet)
        tell("run ended", status=status)
    sys.exit(status or (3 if planned.refused else 0))


def _run_plans(plans: list[Any], out: Path, options: RunOptions, as_json: bool, quiet: bool, verbose: bool) -> int:
    """Run all plans, publish the index, say what was found; returns the exit status."""
    reporting = _started(plans, options.jobs)
    try:
        from crankorder.batch.execute import run_plans
        from crankorder.batch.plan import index_document
        from crankorder.batch.store import json_bytes

        if any("findings" in plan.settings.report.results for plan in plans):
            import crankorder.identify.findings  # noqa: F401  # while no garbage is looked for
        gc.freeze()  # nor is what was loaded ever garbage: looking through it costs 0.2 s while kernels load
        gc.enable()
        outcomes = run_plans(
            plans, out, options, reporting=reporting, watched=lambda name: _progress(quiet, name),
            tell=lambda outcome: _say(outcome, quiet, verbose), wait=lambda text: _tell(f"crankorder: {text}"),
        )  # fmt: skip
    finally:
        gc.enable()
        reporting.close()
    if as_json:
        click.echo(json_bytes(index_document([outcome.record for outcome in outcomes])).decode(), nl=False)
    statuses = [outcome.exit_status for outcome in outcomes]
    worst = next((status for status in (1, 5) if status in statuses), None)
    if worst is None and statuses and all(status == 4 for status in statuses):
        return 4
    return worst or (3 if any(statuses) else 0)


def _prune(plans: list[Any], out: Path, keep_mb: float, quiet: bool) -> None:
    """Leave at most ``keep_mb`` megabytes of what the recordings of these tests gave, and say how much it is."""
    from crankorder.batch.frame_store import STORE, FrameStore, prune

    left = prune([FrameStore.of(plan.out).folder for plan in plans], most_bytes=1e6 * keep_mb)[2]
    if left and not quiet:
        kept = f"{left / 1e6:.3g} MB in {out / STORE} spare a further run the computing"
        _tell(f"{kept} (less: --keep-frames MB, none: crankorder clean)")


def _started(plans: list[Any], jobs: int) -> ReportingProcess:
    """A process that hashes inputs and loads what draws and writes, while this process loads what analyses."""
    gc.disable()  # modules that load make no garbage, and looking for it costs a fifth of the time
    atexit.register(gc.freeze)  # nor is it worth 0.4 s to take everything apart before the process ends
    import h5py  # noqa: F401  # this and the next are needed by both, so they are loaded before it is split off
    import xarray  # noqa: F401

    from crankorder.batch.publish import ReportingProcess

    return ReportingProcess(plans, jobs=jobs)


def _say(outcome: Outcome, quiet: bool, verbose: bool) -> None:
    from crankorder.report.sentences.story import headline

    name = printable(outcome.plan.name)
    _tell(*(f"crankorder: {name}: {said}" for said in (*outcome.faults, *outcome.notes)))
    alike: dict[str, list[BaseException]] = {}
    for error in outcome.internal:
        alike.setdefault(f"{type(error).__name__}: {error}", []).append(error)
    for error_text, errors in alike.items():
        count = f" ({len(errors)} recordings)" if len(errors) > 1 else ""
        _tell(f"crankorder: {name}: internal fault{count}: {printable(error_text, 1000)}")
        if verbose:
            _tell(*"".join(traceback.format_exception(errors[0])).split("\n"))
    if quiet:
        return
    if outcome.findings is not None:
        _tell(*headline(outcome.findings))
    if outcome.status == "kept":
        _tell(f"{name}: {len(outcome.plan.recordings)} recordings kept for --reduce")
    elif outcome.status != "failed":
        note = "unchanged, kept" if outcome.kept else "done"
        _tell(f"{name}: {note}: {outcome.plan.out / 'report.html'}")
    if verbose:
        if outcome.accuracy:
            _tell(f"  {outcome.accuracy}")
        if outcome.reused:
            _tell(f"  {outcome.reused} of {len(outcome.plan.recordings)} recordings as kept before")
        _tell(*(f"  {stage}: {seconds:.2f} s" for stage, seconds in outcome.seconds.items()))


@contextlib.contextmanager
def _progress(quiet: bool, label: str) -> Iterator[Callable[[str, int, int], None]]:
    """Show a progress bar on stderr, on a terminal only; what is given is told of what is done, and of how much."""
    if quiet or not sys.stderr.isatty():
        yield lambda _, done, total: None
        return
    with click.progressbar(length=1, label=printable(label), file=sys.stderr) as bar:

        def update(_: str, done: int, total: int) -> None:
            bar.length = total
            bar.update(done - bar.pos)

        yield update


@main.command()
@_folders
@_manifest
@_jobs
def check(folders: tuple[Path, ...], manifest: Path | None, jobs: int) -> None:
    """Look at manifest, files and a bounded part of their samples; list every fault at once, change nothing."""
    from crankorder.ingest.check import manifest_faults

    statuses: list[int] = []
    for folder in folders:
        # only a right manifest is worth the time of heavy imports
        wrong = manifest_faults(folder, manifest)
        found, usable = (wrong, 0) if wrong else _look_at(folder, manifest, jobs)
        _tell(*(f"crankorder: {fault}" for fault in found))
        worst = max((fault.exit_status for fault in found), default=0)
        statuses.append(4 if worst == 3 and not usable else worst)
    # as `run`: 4 only where nothing at all can be used
    sys.exit(3 if max(statuses) == 4 and min(statuses) < 4 else max(statuses))


def _look_at(folder: Path, manifest: Path | None, jobs: int) -> tuple[list[CrankorderError], int]:
    """Show what every recording in ``folder`` is; the faults that were found, and how many recordings can be used."""
    from crankorder.batch.look import look_at, percent

    found = look_at(folder, manifest, jobs=jobs)
    for look in found.looks:
        _tell(printable(look.line, 400), *(f"    {printable(remark, 400)}" for remark in look.remarks), err=False)
    if not found.faults:
        doubts = sum(bool(look.remarks) for look in found.looks)
        also = f"; {doubts} of {len(found.looks)} recordings have doubtful places" if doubts else ""
        read = f" in the {percent(found.share)} that was read" if found.looks else ""
        _tell(f"{folder}: no fault found{read}{also}")
    return found.faults, len(found.looks)


@main.command()
@click.argument("folder", type=FOLDER)
@click.option("--save", is_flag=True, help="Write FOLDER/run.toml, or one into each folder of recordings in FOLDER.")
def init(folder: Path, save: bool) -> None:
    """Draft run.toml from what the files say: printed, or with --save written where no manifest is yet.

    Recordings that differ in format, columns, units or wheel get manifests of their own, each run with --manifest.
    """
    from crankorder.ingest.draft import draft_manifests, save_drafts
    from crankorder.ingest.rawfile import listed

    drafts = save_drafts(folder) if save else draft_manifests(folder)
    for draft in drafts.all:
        if not save:
            click.echo(draft.text, nl=False)
        done = "draft written" if save else "draft"
        how = "" if draft.path.name == "run.toml" else f"; run it with --manifest {draft.path}"
        _tell(f"{draft.path}: {done} for {listed(draft.files, 5)}; decide what stands behind `# ?`{how}")
    _tell(*(f"passed over: {reason}" for reason in drafts.passed))


@main.command()
@click.option("--out", required=True, type=FOLDER, help="Folder for accuracy.json and accuracy.txt; made if missing.")
@click.option("--on", type=FOLDER, metavar="RESULT", help="Results of a test: its synthetic twin is analysed.")
@click.option("--draws", type=click.IntRange(1, 100), default=1, show_default=True, help="Twins that are drawn.")
def accuracy(out: Path, on: Path | None, draws: int) -> None:
    """Measure speed against error here, or how well a test of yours can be analysed: by a twin whose truth is known."""
    from crankorder.batch.accuracy import publish_accuracy

    paths, text = publish_accuracy(out, on=on, draws=draws)
    click.echo(text, nl=False)
    _tell(*paths)


@main.command()
@click.argument("out", type=FOLDER)
@click.option(
    "--unused", "days", type=click.FloatRange(0), default=0, metavar="DAYS", help="Only what no run has used for DAYS."
)
def clean(out: Path, days: float) -> None:
    """Remove from OUT what `run` keeps of single recordings, so that it need not compute them again; results stay."""
    from crankorder.batch.frame_store import STORE, prune

    count, size, left = prune([out / STORE], unused_s=86400 * days)
    stays = f"; {left / 1e6:.1f} MB used since then stay" if left else ""
    _tell(f"{out}: {count} files, {size / 1e6:.1f} MB removed{stays}")


@main.command()
@click.argument("results", nargs=-1, required=True, type=FOLDER, metavar="RESULT...")
@_picture_options
def report(results: tuple[Path, ...], report: ReportOptions) -> None:
    """Redraw pictures and page from results (folders that `run` made, or their results.nc)."""
    from crankorder.batch.publish import redraw

    for result in results:
        _tell(redraw(result, report=report), err=False)


@main.command()
@click.argument("base", type=FOLDER)
@click.argument("new", nargs=-1, required=True, type=FOLDER, metavar="NEW...")
@click.option("--out", required=True, type=FOLDER, help="Folder for comparison.json, page, pictures and comparison.nc.")
@click.option(
    "--fdr", "q", type=click.FloatRange(0, 0.5, min_open=True), default=0.05, show_default=True,
    help="False-discovery rate: the share of the claimed changes that may be chance.",
)  # fmt: skip
@_as_json
@_quiet
@_picture_options
def compare(
    base: Path, new: tuple[Path, ...], out: Path, q: float, as_json: bool, quiet: bool, report: ReportOptions
) -> None:
    """Compare results: two builds, or one build over time (NEW... in time order; the last is compared with BASE).

    Of two --out of several tests each test is compared with its partner.
    """
    from crankorder.batch.compare import compare_results, document_text, publish_comparison

    results = compare_results(base, new, q=q)
    for path in publish_comparison(results, out, report=report):
        if not quiet:
            _tell(path)
    if as_json:
        click.echo(document_text(results), nl=False)
    elif not quiet:
        _tell(*results.document.headline, err=False)
    if not results.document.comparable:
        _tell(f"crankorder: {results.document.headline[0]}")
        for confound in (c for c in results.document.confounds if c.severity == "invalid"):
            _tell(f"crankorder: not comparable: {confound.what}: {confound.words}")
        sys.exit(4)


@main.command()
@click.argument("result", type=FOLDER)
@click.option("--to", required=True, type=click.Choice(["uff58", "csv", "parquet"]), help="What is written.")
@click.option("--binary", is_flag=True, help="Universal files in binary form (58b).")
@click.option(
    "--out", type=FOLDER, default=Path("crankorder-export"), show_default=True, help="Folder; made if missing."
)
def export(result: Path, to: str, binary: bool, out: Path) -> None:
    """Write RESULT (of a test, or of a whole --out) for other programs: a folder TEST-FORMAT in --out for each test.

    uff58: order cuts against rpm and waterfalls of orders and frequencies. csv, parquet: tracks, modes, crossings,
    lines and what else was found, each column with its unit; parquet also the maps.
    """
    from crankorder.batch.publish import export_results

    _tell(*export_results(result, out, to=to, binary=binary), err=False)


@main.command()
@click.argument("engine")
@_as_json
@click.option("--out", type=FOLDER, help="Folder for balance.json, pictures and balance.nc; made if missing.")
@click.option(
    "--speed", "speeds_rpm", metavar="RPM", multiple=True, type=click.FloatRange(0, MAX_SPEED_RPM, min_open=True),
    help="Crank speed at which forces are given; repeat it for more. [default: those of the engine file]",
)  # fmt: skip
@click.option("--max-order", type=click.IntRange(4, 1000), default=8, show_default=True, help="Highest order shown.")
@click.option("--all", "whole", is_flag=True, help="Every table too, not one screen.")
@_picture_options
def balance(engine: str, as_json: bool, out: Path | None, whole: bool, report: ReportOptions, **asked: Any) -> None:
    """Predict forces by order, balance strategies, shafts and residuals of ENGINE, a shipped name or a TOML file."""
    from crankorder.batch.balance import balance_of, document_text, publish_balance, table_text

    made = balance_of(engine, **asked)
    if out is not None:
        _tell(*publish_balance(made, out, report=report))
    if as_json:
        click.echo(document_text(made))
    else:
        _tell(*table_text(made, whole=whole).removesuffix("\n").split("\n"), err=False)


@main.command()
@click.argument("scene")
@click.option("--out", required=True, type=FOLDER, help="Folder for the recordings; made if missing.")
@click.option("--quick", is_flag=True, help="The scene's short version.")
@_quiet
def synth(scene: str, out: Path, quick: bool, quiet: bool) -> None:
    """Write a test-run folder, with the truth in truth.json."""
    _tell(*_synthesise(scene, out, quick, quiet), err=False)


def _synthesise(scene: str, out: Path, quick: bool, quiet: bool) -> list[Path]:
    from crankorder.synth.write import write_scene

    with _progress(quiet, f"synthesise {scene}") as progress:
        return write_scene(scene, out, quick=quick, progress=lambda done, total: progress("", done, total))


@main.command()
@click.option(
    "--out", type=FOLDER, default=Path("crankorder-demo"), show_default=True, help="Folder for recordings and results."
)
@click.option("--quick", is_flag=True, help="A short version, for a first look.")
@_run_options
def demo(out: Path, quick: bool, jobs: int, as_json: bool, quiet: bool, verbose: bool) -> None:
    """Synthesise the reference campaign from the engine model and analyse it."""
    from crankorder.batch.plan import RunOptions, plan_tests

    recordings = out / "recordings"
    if not quiet:
        _tell(f"synthesising the campaign into {recordings} …")
    _synthesise(DEMO_SCENE, recordings, quick, quiet)
    plans = plan_tests([recordings], out / "results").tests
    status = _run_plans(plans, out / "results", RunOptions(jobs=jobs), as_json, quiet, verbose)
    if status == 0 and not as_json:
        _tell(*sorted(plans[0].out.glob("*.png")), err=False)
    sys.exit(status)


@main.command()
@click.option("--out", type=FOLDER, default=Path(), show_default="this folder", help="Folder to test for results.")
def doctor(out: Path) -> None:
    """Versions, processor, FFTW, free space, and whether known answers hold."""
    from crankorder.batch.accuracy import known_answers, surroundings

    click.echo("\n".join(surroundings(out)))
    answers = known_answers()
    for answer in answers:
        click.echo(f"{answer.question}: error {answer.error:.1e}: {'good' if answer.holds else 'BAD'}")
    if not all(answer.holds for answer in answers):
        raise EnvironmentFailure("a known answer does not hold", remedy="Reinstall crankorder in a new environment")
