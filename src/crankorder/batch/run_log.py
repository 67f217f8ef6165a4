"""The log of a run: what was computed, reused and left out, and why; a file for each run, apart from the results."""

from __future__ import annotations

import contextlib
import json
import logging
import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from crankorder.errors import printable

LOGS = ".crankorder-logs"
"""Folder in a folder of results that holds the logs."""

KEPT_LOGS = 50
"""The newest logs that are kept; each run that begins one removes what is older."""

LOGGER = logging.getLogger("crankorder.run")
"""A program of one's own that wants to hear of it adds a handler; each record has the ``fields`` of its event."""
LOGGER.addHandler(logging.NullHandler())


def tell(event: str, *, level: int = logging.INFO, **fields: object) -> None:
    """Log the ``event``, a word or two, at ``level`` with its ``fields``, numbers and texts by name."""
    if LOGGER.isEnabledFor(level):
        LOGGER.log(level, event, extra={"fields": fields})


@contextlib.contextmanager
def logged(out: Path, *, as_json: bool) -> Iterator[Path | None]:
    """Log what is told meanwhile into a new file below ``out``: its path, None where none can be written.

    A line for each event; with ``as_json`` a JSON document each. A disk that gets full ends the log, not the run.
    """
    folder = out / LOGS
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}-{os.getpid()}.{'jsonl' if as_json else 'log'}"
        handler = _Handler(path, encoding="utf-8", errors="backslashreplace")
    except OSError:
        yield None
        return
    handler.setFormatter(_AsJson() if as_json else _AsText())
    level, LOGGER.propagate = LOGGER.level, False
    LOGGER.addHandler(handler)
    LOGGER.setLevel(min(level or logging.INFO, logging.INFO))
    try:
        with contextlib.suppress(OSError):
            for old in sorted(folder.iterdir())[:-KEPT_LOGS]:
                old.unlink(missing_ok=True)
        yield path
    finally:
        LOGGER.removeHandler(handler)
        LOGGER.setLevel(level)
        LOGGER.propagate = True
        with contextlib.suppress(OSError):
            handler.close()


class _Handler(logging.FileHandler):
    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's name
        """Leave the run alone: a log that cannot be written is no fault of it."""


def _time_of(record: logging.LogRecord) -> str:
    return datetime.fromtimestamp(record.created, UTC).isoformat("T", "milliseconds").replace("+00:00", "Z")


def _fields_of(record: logging.LogRecord) -> dict[str, object]:
    return dict(getattr(record, "fields", {}))


class _AsText(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        """Time, level, event and its fields in one line."""
        fields = "; ".join(f"{name} {printable(value, 1000)}" for name, value in _fields_of(record).items())
        return f"{_time_of(record)} {record.levelname} {record.getMessage()}: {fields}"


class _AsJson(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        """One JSON document in one line, ASCII alone."""
        about = {"time": _time_of(record), "level": record.levelname, "event": record.getMessage()}
        return json.dumps({**about, **_fields_of(record)}, default=_text)


def _text(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else str(value)
