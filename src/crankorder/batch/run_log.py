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
    handler.setFormatter(_Line(as_json))
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


class _Line(logging.Formatter):
    def __init__(self, as_json: bool) -> None:
        super().__init__()
        self._as_json = as_json

    def format(self, record: logging.LogRecord) -> str:
        """Time, level, event and its fields in one line: as words, or as a JSON document, ASCII alone."""
        moment = datetime.fromtimestamp(record.created, UTC).isoformat("T", "milliseconds").replace("+00:00", "Z")
        level, event, fields = record.levelname, record.getMessage(), dict(getattr(record, "fields", {}))
        if self._as_json:
            return json.dumps({"time": moment, "level": level, "event": event, **fields}, default=_text)
        return f"{moment} {level} {event}: {'; '.join(f'{key} {printable(fields[key], 1000)}' for key in fields)}"


def _text(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else str(value)
