"""Every fault of a test-run folder at once, found without reading samples and without changing anything."""

from __future__ import annotations

from pathlib import Path

from crankorder.errors import MOST_TOLD, CrankorderError, InputError, ManyErrors, RequestError
from crankorder.ingest.channel import file_to_analysed
from crankorder.ingest.encoder_table import SOURCELESS_KINDS
from crankorder.ingest.folder import check_regular, checksum_faults, collected, recordings_of
from crankorder.ingest.manifest import MANIFEST_NAME, Manifest, load_manifest
from crankorder.settings import IngestSettings


def check_folder(folder: Path, manifest_path: Path | None = None, *, settings: IngestSettings) -> list[CrankorderError]:
    """All faults of the test-run folder ``folder``: of its manifest, then of every file that this names.

    ``manifest_path`` names a manifest that lies elsewhere; ``settings`` limit what is opened. With an empty list the
    folder can be analysed, as far as names, sizes, rates and units tell; samples are not read. Faults are returned, not
    raised.
    """
    if faults := manifest_faults(folder, manifest_path):
        return faults
    manifest = load_manifest(folder, manifest_path)
    recordings = recordings_of(folder, manifest)
    faults = list(recordings.faults)
    if manifest.sampling.domain == "time" and manifest.encoder.kind == "none" and manifest.test.cycle != "none":
        problem, file = "nothing tells the speed", manifest_path or folder / MANIFEST_NAME
        place, allowed = "encoder.kind", 'an encoder, a speed channel, a constant speed_rpm, or kind = "vibration"'
        remedy = 'Name one, or state cycle = "none" for a structure without a shaft'
        faults.append(RequestError(problem, file=file, place=place, found="none", allowed=allowed, remedy=remedy))
    of_pulses = [pulses for path in recordings.paths if (pulses := manifest.pulses_of(path)) is not None]
    faults += checksum_faults(folder, [*recordings.paths, *of_pulses], manifest.recordings.files)
    for path in recordings.paths:
        faults += check_recording(path, manifest, settings=settings)
    return faults


def manifest_faults(folder: Path, manifest_path: Path | None = None) -> list[CrankorderError]:
    """All faults of the manifest of the test-run folder ``folder``, or of that at ``manifest_path``.

    Where the manifest has none, they are those of the files that it names, if none of these can be opened.
    """
    try:
        recordings = recordings_of(folder, load_manifest(folder, manifest_path))
    except ManyErrors as error:
        return error.faults
    except CrankorderError as error:
        return [error]
    return [] if recordings.paths else list(recordings.faults)


def check_recording(path: Path, manifest: Manifest, *, settings: IngestSettings) -> list[CrankorderError]:
    """All faults of the recording at ``path`` that show without reading its samples, against ``manifest``.

    ``settings`` limit what is opened.
    """
    # heavy: only a right manifest is worth their time
    from crankorder.ingest.formats import contents_of
    from crankorder.ingest.rawfile import Contents, named
    from crankorder.ingest.sampling import agreed_rate, bases_of, length_faults

    faults: list[CrankorderError] = []
    try:
        contents = contents_of(path, settings=settings)
    except CrankorderError as error:
        return [error]
    pulses, encoder = manifest.pulses_of(path), manifest.encoder
    if pulses is not None:
        with collected(faults):
            check_regular(pulses, path.parent)
            listed = contents_of(pulses, settings=settings).names
            told = (encoder.source, encoder.index, encoder.cam, encoder.time_source)
            for source in (source for source in told if source is not None):
                with collected(faults):
                    named(source, listed, pulses)
    names: dict[str, str] = {}
    for number, (role, source) in enumerate(roles := _roles(manifest).items()):
        if len(faults) >= MOST_TOLD:
            problem = f"{len(roles) - number} more of the channels that the manifest names were not looked at"
            return [*faults, InputError(problem, file=path, remedy="Mend these first")]
        with collected(faults):
            names[role] = named(source, contents.names, path)
    for channel in manifest.channels:
        with collected(faults):
            if channel.name in names:
                file_to_analysed(channel, contents.units.get(names[channel.name], ""), path)
    sampled = {role: names[role] for role in manifest.sampled if role in names}
    timed = contents if manifest.sampling.domain == "time" else Contents(contents.format, contents.names)
    n_channels = sum(channel.name in sampled for channel in manifest.channels)
    bases, file_hz = bases_of(sampled, contents.samples, timed, n_channels, tolerance=settings.rate_tolerance)
    faults += length_faults(bases, path)
    if manifest.sampling.domain == "time" and manifest.sampling.time_source is None and manifest.has_samples:
        with collected(faults):
            rates = {"manifest": (manifest.sampling.rate_hz, 0.0), "file": (file_hz, contents.rate_uncertainty)}
            agreed_rate(rates, path, settings=settings)
    return faults


def _roles(manifest: Manifest) -> dict[str, str | int]:
    """Sources that the manifest asks for, by what they are for."""
    roles: dict[str, str | int | None] = {channel.name: channel.file_source for channel in manifest.channels}
    encoder = manifest.encoder
    if encoder.kind not in SOURCELESS_KINDS and encoder.file is None:
        roles |= {"the encoder": encoder.source, "the index": encoder.index, "the cam mark": encoder.cam}
    elif encoder.kind == "constant":
        roles["the speed"] = encoder.source
    if manifest.sampling.domain == "time":
        roles["the time"] = manifest.sampling.time_source
    return {role: source for role, source in roles.items() if source is not None}
