"""A folder yields the recordings that the manifest names, and nothing outside it is ever touched."""

import json
import os
import socket
from pathlib import Path
from unittest.mock import Mock

import pytest

from crankorder.errors import InputError, NoUsableRecordingError, RequestError
from crankorder.ingest.folder import check_regular, recordings_of
from crankorder.ingest.formats import contents_of, format_of

HEAD = 'schema_version = 1\n[test]\ncycle = "rotor"\n[recordings]\nfiles = {}\n'
CHANNEL = '[[channels]]\nname = "a"\nunit = "V"\n'


@pytest.fixture
def found_in(manifest_of):
    def find(folder, *files):
        return recordings_of(folder, manifest_of(CHANNEL, HEAD.format(json.dumps(files))))

    return find


def touched(folder, *names):
    for name in names:
        (folder / name).write_bytes(b"1\n")


def test_leftovers_of_copies_and_editors_are_passed_over(tmp_path, found_in):
    touched(tmp_path, "x.h5", "x.h5.part", "._x.h5", ".~lock.x.h5#", "Thumbs.db", ".x.h5.Ab12", "x.h5~", "run.toml")
    folder = found_in(tmp_path, "*")
    assert [path.name for path in folder.paths] == ["x.h5"]
    assert not folder.faults
    assert {"x.h5.part", "Thumbs.db", "._x.h5"} <= set(folder.ignored)


def test_recordings_come_in_natural_order_and_a_name_with_the_characters_of_a_pattern_is_found(tmp_path, found_in):
    for names, pattern, paths in (
        (("2000.h5", "300.h5", "1000.h5", "notes.txt"), "*.h5", ["300.h5", "1000.h5", "2000.h5"]),
        (("run [2].h5", "run 2.h5"), "run [2].h5", ["run [2].h5"]),
    ):
        touched(tmp_path, *names)
        assert [path.name for path in found_in(tmp_path, pattern).paths] == paths


def test_an_empty_folder_says_what_was_looked_for(tmp_path, found_in):
    with pytest.raises(NoUsableRecordingError, match=r"no recording found; looked for \*\.h5, b\*; found an empty"):
        found_in(tmp_path, "*.h5", "b*")


def test_a_folder_without_permission_is_told_as_one(tmp_path, found_in, monkeypatch):
    monkeypatch.setattr(Path, "is_symlink", Mock(side_effect=PermissionError(13, "Permission denied")))
    assert "no permission to read" in str(found_in(tmp_path, "a.h5").faults[0])


def test_a_path_out_of_the_folder_is_refused(tmp_path, found_in):
    (tmp_path / "secret.h5").write_bytes(b"1\n")
    (tmp_path / "run").mkdir()
    names = ["../secret.h5", "/etc/passwd", "~/secret.h5", "a/../../secret.h5", "\0", r"..\secret.h5", r"C:\secret.h5"]
    for name in names:
        with pytest.raises(RequestError, match=r"recordings\.files\.0: files outside the folder of the test"):
            found_in(tmp_path / "run", name)


def test_a_link_out_of_the_folder_is_refused_and_one_inside_is_followed(tmp_path, found_in):
    run = tmp_path / "run"
    run.mkdir()
    touched(tmp_path, "secret.h5")
    touched(run, "a.h5")
    (run / "b.h5").symlink_to("a.h5")
    (run / "c.h5").symlink_to(tmp_path / "secret.h5")
    (run / "d.h5").symlink_to("d.h5")
    (run / "e.h5").symlink_to("nothing.h5")
    folder = found_in(run, "*.h5")
    assert [path.name for path in folder.paths] == ["a.h5", "b.h5"]
    said = ("outside the run folder", "a link that leads to itself", "a link to nothing")
    for words, text in zip(said, sorted(map(str, folder.faults)), strict=True):
        assert words in text


def test_pipes_folders_sockets_and_devices_are_refused_without_opening(tmp_path, found_in):
    os.mkfifo(tmp_path / "pipe.h5")
    (tmp_path / "folder.h5").mkdir()
    with socket.socket(socket.AF_UNIX) as server:
        here = Path.cwd()
        try:
            os.chdir(tmp_path)  # socket names are limited to 108 bytes
            server.bind("socket.h5")
        finally:
            os.chdir(here)
        folder = found_in(tmp_path, "*.h5")
    assert not folder.paths
    texts = " ".join(map(str, folder.faults))
    assert all(f"not a file but a {kind}" in texts for kind in ("named pipe", "folder", "socket"))
    with pytest.raises(InputError, match="not a file but a named pipe"):
        format_of(tmp_path / "pipe.h5")
    with pytest.raises(InputError, match="not a file but a device"):
        check_regular(Path("/dev/zero"))


def test_odd_names_are_files_like_any_other(tmp_path, found_in):
    names = [
        "run 1.h5", "a\nb.h5", "-rf.h5", "é.h5", "e\u0301.h5", "x" * 250 + ".h5", "CON.h5", "a\\b.h5", "run [2].h5",
        "%2e%2e.h5",
    ]  # fmt: skip
    for name in names:
        touched(tmp_path, name)
        assert [path.name for path in found_in(tmp_path, "*.h5").paths] == [name]
        (tmp_path / name).unlink()


def test_a_name_that_is_not_utf_8_is_shown_escaped(tmp_path, found_in):
    touched(tmp_path, os.fsdecode(b"a\xff.h5"))
    (path,) = found_in(tmp_path, "*.h5").paths
    with pytest.raises(InputError, match=r"a\\udcff\.h5: is text, though its name ends in \.h5"):
        format_of(path)


HEAD_HDF = (
    b"start of data: 8192\r\nnumber of channels: 2\r\nnbr of scans: 4410\r\nchannel definition: 1\r\ncalibration: 93.5"
)


def test_a_file_that_is_not_what_it_seems_is_named_by_its_content(tmp_path, limits):
    rows = [
        ("a.hdf", HEAD_HDF.ljust(8192, b" ") + bytes(8000), "HEAD acoustics file.*ArtemiS"),
        ("a.dat", HEAD_HDF.ljust(500, b"\0") + bytes(8000), "HEAD acoustics file.*ArtemiS"),
        ("a.dxd", b"MULTI_STREAM_FILE_VER02106\0\0\0Dewesoft_Data_7.x__" + bytes(900), "Dewesoft file.*DewesoftX"),
        ("a.d7d", b"\x01\x02\0\0DEWESoft 7" + bytes(900), "Dewesoft file.*DewesoftX"),
        ("a.001", b"\0\0AVL I-FILE V2.1\0" + bytes(900), "AVL IFile.*Concerto"),
        ("a.h5", b"", "truncated: the file is empty"), ("a.h5", b"\0" * 5000, "holds only zeros"),
        ("a.h5", b"time,acc\n0,1\n", r"is text, though its name ends in \.h5"),
        ("a.mat", b"<!DOCTYPE html><html>404", "is an HTML or XML page: not a recording"),
        ("a.hdf", b"HEAD acoustics\n1 2 3\n", "HEAD .hdf is a format of its own.*Export UFF58, WAV or HDF5"),
        ("a.pkl", b"\x80\x04\x95\x00", "is a Python pickle, which can run code: never opened"),
        ("a.xyz", b"\x01\x02\x00\x03", "content is not known.*first bytes 01 02 00 03"),
        ("a.h5", b"\x89", "truncated: only 1 bytes are left"),
        ("a.xlsx", b"PK\x03\x04" + b"\0" * 50, "truncated or damaged"), ("a.csv", b"\xff\xfea\0", "is UTF-16 text"),
    ]  # fmt: skip
    for name, content, words in rows:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=rf"(?s)a\..*{words}"):
            contents_of(tmp_path / name, settings=limits)
