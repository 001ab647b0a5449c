"""Generating: the same bytes from any workers and after any kill; clear ends; held-out parts."""

import errno
import hashlib
import importlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simple_samples import CONFIG, generate_simple, simple_film

import data_gen.generate
import data_gen.work
from data_gen import manifest
from data_gen.ct.folder import load_volumes, with_left_out
from data_gen.ct.volumes import CtVolume
from data_gen.generate import GenerateConfig, generate
from data_gen.light.rooms import Environment
from data_gen.manifest import sole_writer
from data_gen.prints.prints import PrintConfig
from data_gen.sample import SampleConfig
from data_gen.sources import SourceConfig, draw_environment, draw_volume, loaded
from data_gen.work import Workers, film_bytes, workers
from hybrid.errors import ConfigError, DataError, HybridError
from hybrid.learn.datasets.shards import open_dataset
from hybrid.mesh.recipes import BendConfig

ROOT = Path(__file__).parents[1]
REAL = SampleConfig(
    size=48, map_size=32, photos_per_film=1, bend=BendConfig(frames=3, keep_from=1), prints=PrintConfig(longer_px=256)
)


def hashes(folder):
    """The sha256 of every file of a data set, by name."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


@pytest.fixture
def simple(monkeypatch):
    """Instant samples, and no card, because a card needs real samples."""
    monkeypatch.setattr(data_gen.work, "film_samples", simple_film)
    monkeypatch.setattr(data_gen.generate, "write_card", lambda folder: None)


def simple_config(out, count=11, **options):
    return GenerateConfig(
        **{"count": count, "out": out, "size": 48, "map_size": 32, "workers": 0, "shard_size": 4, "sample": CONFIG}
        | options
    )


# ---------------------------------------------------------------- the same bytes


def test_processes_and_a_cluster_make_the_same_bytes():
    distributed = pytest.importorskip("distributed")
    tasks = [(3, number, REAL) for number in range(2)]
    here = [film_bytes(*task) for task in tasks]
    with workers(2, None) as those:
        assert list(those.in_order(film_bytes, tasks)) == here
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, host="127.0.0.1", protocol="tcp", dashboard_address=None
        ) as cluster,
        workers(0, cluster.scheduler_address) as those,
    ):
        assert list(those.in_order(film_bytes, tasks[:1])) == here[:1]


def test_few_tasks_are_under_way_and_their_order_is_kept():
    given = []

    def submit(task, n):
        given.append(n)
        future = Future()
        future.set_result(task(n))
        return future

    for done, result in enumerate(Workers(submit, lambda: 3).in_order(abs, ((-n,) for n in range(20)))):
        assert result == done
        assert len(given) - done <= 3
    assert done == 19


def test_a_set_does_not_depend_on_what_was_there(simple, tmp_path):
    generate(simple_config(tmp_path / "a"))
    generate(simple_config(tmp_path / "b", count=3))
    generate(simple_config(tmp_path / "b", count=7))  # completes the last shard
    (tmp_path / "b/shard_00000.tar").unlink()
    generate(simple_config(tmp_path / "b"))
    assert hashes(tmp_path / "a") == hashes(tmp_path / "b")
    generate(simple_config(tmp_path / "b", count=2))  # nothing is taken away
    assert hashes(tmp_path / "a") == hashes(tmp_path / "b")
    shards = open_dataset(tmp_path / "a", verify=True)
    assert [len(shard) for shard in shards] == [4, 4, 3]
    films = [(shard.record(k)["film"], shard.record(k)["photo"]) for shard in shards for k in range(len(shard))]
    assert films == [(n // 2, n % 2) for n in range(11)]


def test_killed_at_any_moment_it_goes_on_to_the_same_bytes(tmp_path):
    """SIGKILL at random moments, again and again, on one folder."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["data_gen.generate"])  # imported once, not by each process
    rng = np.random.default_rng(0)

    def run(out, kill_after=None):
        started = context.Event()
        process = context.Process(target=generate_simple, args=(out, 40, 4, started))
        process.start()
        assert started.wait(60)
        if kill_after is not None:
            time.sleep(kill_after)
            process.kill()
        process.join(60)
        return process.exitcode

    begun = time.perf_counter()
    assert run(tmp_path / "whole") == 0
    seconds = time.perf_counter() - begun
    ends = [run(tmp_path / "cut", rng.uniform(0, min(seconds, 1.0) / 4)) for _ in range(6)]
    assert -signal.SIGKILL in ends
    assert run(tmp_path / "cut") == 0
    assert hashes(tmp_path / "cut") == hashes(tmp_path / "whole")
    assert sum(len(shard) for shard in open_dataset(tmp_path / "cut", verify=True)) == 40


@pytest.mark.parametrize("lost", ["entry", "manifest"])
def test_a_shard_that_the_manifest_lacks_is_added(simple, tmp_path, lost):
    """As after a kill between writing the shard and the manifest."""
    generate(simple_config(tmp_path))
    before, path = hashes(tmp_path), tmp_path / "manifest.json"
    if lost == "manifest":
        path.unlink()
    else:
        manifest = json.loads(path.read_text())
        path.write_text(json.dumps(manifest | {"shards": manifest["shards"][:-1]}))
    (tmp_path / "shard_00009.tar.part").write_bytes(b"cut off")
    made = (tmp_path / "shard_00001.tar").stat().st_mtime_ns
    generate(simple_config(tmp_path))
    assert hashes(tmp_path) == before
    assert (tmp_path / "shard_00001.tar").stat().st_mtime_ns == made


def test_workers_end_when_their_parent_is_killed(tmp_path):
    code = (
        "import multiprocessing, os, time\n"
        "from data_gen.work import workers\n"
        "if __name__ == '__main__':\n"
        "    with workers(1, None) as those:\n"
        "        print(next(those.in_order(os.getpid, [()])), flush=True)\n"
        "        time.sleep(600)\n"
    )
    script = tmp_path / "script.py"
    script.write_text(code)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True, env=environment) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        parent.kill()
    deadline = time.monotonic() + 60
    while _runs(child):
        assert time.monotonic() < deadline, "the worker outlived its parent"
        time.sleep(0.02)


def _runs(pid):
    try:
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


# ---------------------------------------------------------------- clear ends


def test_a_full_disk_leaves_no_half_shard(simple, tmp_path, monkeypatch):
    fsync, calls = os.fsync, []

    def full(handle):
        calls.append(handle)
        if len(calls) > 6:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DataError, match=r"No space left.*finished shards are kept"):
        generate(simple_config(tmp_path / "d"))
    assert not list((tmp_path / "d").glob("*.part"))
    monkeypatch.setattr(os, "fsync", fsync)
    generate(simple_config(tmp_path / "d"))
    generate(simple_config(tmp_path / "whole"))
    assert hashes(tmp_path / "d") == hashes(tmp_path / "whole")


def test_a_process_that_dies_is_said(tmp_path):
    with pytest.raises(HybridError, match=r"a process that died.*finished shards are kept"), workers(1, None) as those:
        list(those.in_order(os._exit, [(3,)]))


def test_a_data_set_made_otherwise_is_not_mixed_in(simple, tmp_path):
    generate(simple_config(tmp_path, count=2))
    for options in ({"seed": 9}, {"shard_size": 8}, {"size": 64}, {"sources": SourceConfig(phantoms=(3, 4))}):
        with pytest.raises(ConfigError, match="another --out"):
            generate(simple_config(tmp_path, **options))


@pytest.mark.parametrize("before", ["other sources", None])
def test_a_data_set_of_other_sources_is_read_and_not_gone_on_with(simple, tmp_path, before):
    """None: the data set was begun before digests were kept."""
    generate(simple_config(tmp_path, count=2))
    path = tmp_path / "dataset.json"
    described = json.loads(path.read_text())
    rest = {name: value for name, value in described.items() if name != "generator"}
    path.write_text(json.dumps(rest if before is None else rest | {"generator": before}))
    assert len(open_dataset(tmp_path)) == 1
    with pytest.raises(ConfigError, match=r"another generator\. Go on with the version.*another --out"):
        generate(simple_config(tmp_path, count=8))


def test_each_source_that_simulates_counts(tmp_path, monkeypatch):
    for name in ("data_gen/scene/scene.py", "hybrid/mesh/film.py", "hybrid/coords.py", "hybrid/cli.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("a = 1\n")
    monkeypatch.setattr(manifest, "__file__", str(tmp_path / "data_gen/manifest.py"))
    digests = [manifest.generator_digest.__wrapped__()]
    for name in ("hybrid/cli.py", "hybrid/coords.py", "hybrid/mesh/film.py", "data_gen/scene/scene.py"):
        (tmp_path / name).write_text("a = 2\n")
        digests.append(manifest.generator_digest.__wrapped__())
    assert digests[0] == digests[1]
    assert len(set(digests)) == 4
    (tmp_path / "data_gen/scene/new.py").write_text("")
    assert manifest.generator_digest.__wrapped__() not in digests


def test_a_data_set_of_the_old_layout_is_not_mixed_in(simple, tmp_path):
    (tmp_path / "dataset.json").write_text(json.dumps({"seed": 1, "conventions": 1}))
    with pytest.raises(DataError, match="another folder"):
        generate(simple_config(tmp_path))


def test_a_damaged_shard_is_said(simple, tmp_path):
    generate(simple_config(tmp_path))
    path = tmp_path / "shard_00001.tar"
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(DataError, match=r"shard_00001.*Delete it"):
        generate(simple_config(tmp_path))


def test_two_runs_do_not_write_into_one_folder(simple, tmp_path):
    with sole_writer(tmp_path), pytest.raises(ConfigError, match="another run"):
        generate(simple_config(tmp_path))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"count": 0}, "count: got 0; allowed: >= 1"),
        ({"size": 8}, "size: got 8; allowed: >= 32"),
        ({"workers": -1}, "workers: got -1; allowed: >= 0"),
        ({"map_size": 0}, "map_size: got 0; allowed: >= 16"),
        ({"map_size": 96}, "map size 96; allowed: up to the 48 px"),
        ({"shard_size": 0}, "shard_size: got 0; allowed: >= 1"),
        ({"shard_size": 5}, "shard size 5; allowed: multiples of the 2"),
    ],
)
def test_impossible_options_are_refused(tmp_path, options, told):
    with pytest.raises(ConfigError, match=told):
        simple_config(tmp_path, **options)


def test_a_cluster_that_is_not_there_is_said(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(data_gen.work, "CLUSTER_PATIENCE", "0.5s")
    with pytest.raises(ConfigError, match=r"tcp://host:8786"), workers(0, "tcp://127.0.0.1:9"):
        pass


@pytest.mark.parametrize("address", ["foo", "", "tcp://host", "http://host:8787", "tcp://host:port"])
def test_what_is_no_address_is_refused_at_once(monkeypatch, address):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "Client", None)  # a Client with a refused address ends only after 40 s
    with pytest.raises(ConfigError, match=r"--scheduler.*tcp://host:8786"), workers(0, address):
        pass


@pytest.fixture
def interruptible():
    """Processes started meanwhile obey SIGINT, even if these tests run in the background, where it is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_ends_in_one_line(tmp_path):
    arguments = ["--count", "800", "--out", str(tmp_path / "d"), "--size", "48", "--workers", "1"]
    command = [sys.executable, "-m", "data_gen.generate", *arguments]
    with subprocess.Popen(
        command, cwd=ROOT, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:  # its own group, to which a terminal's Ctrl-C would go
        assert process.stderr is not None
        while not (tmp_path / "d/manifest.json").exists():
            assert process.poll() is None
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)
        said = process.stderr.read()
    assert process.returncode == 130
    assert "Traceback" not in said
    assert said.strip().splitlines()[-1].startswith("stopped")
    assert not list((tmp_path / "d").glob("*.part"))


COMMANDS = {
    "generate": "generate",
    "flat_prints": "flat_prints",
    "lit_films": "lit_films",
    "own_photos": "make_dataset",
}


def ended(monkeypatch, module, *words):
    """How ``python -m data_gen.MODULE`` ends."""
    command = importlib.import_module(f"data_gen.{module}")
    monkeypatch.setattr("sys.argv", [module, *(["pairs"] if module == "own_photos" else ["--count", "1"]), *words])
    with pytest.raises(SystemExit) as end:
        command.main()
    return end.value.code


@pytest.mark.parametrize("module", COMMANDS)
def test_every_command_ends_in_one_line(module, tmp_path, monkeypatch, capsys):
    """It does so whether it is stopped or the system refuses something."""

    def stopped(config):
        raise KeyboardInterrupt

    def full(config):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    function, words = f"data_gen.{module}.{COMMANDS[module]}", ["--out", str(tmp_path / "d")]
    monkeypatch.setattr(function, stopped)
    assert ended(monkeypatch, module, *words) == 130
    kept = "no samples are written, and the same command begins anew"
    told = kept if module == "own_photos" else "what is finished is kept, and the same command goes on"
    assert capsys.readouterr().err == f"stopped; {told}\n"
    monkeypatch.setattr(function, full)
    told = f"error: A file cannot be read or written ({tmp_path / 'd'}): got No space left on device. Mend that"
    assert ended(monkeypatch, module, *words).startswith(told)


@pytest.mark.parametrize("module", COMMANDS)
def test_an_out_that_is_a_file_is_said(module, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr("data_gen.own_photos.pair_paths", lambda folder: [])
    told = f"error: --out ({tmp_path / 'file'}): got a file of this name. Choose another --out."
    assert ended(monkeypatch, module, "--out", str(tmp_path / "file")) == told


@pytest.mark.parametrize("module", ["generate", "flat_prints", "lit_films"])
def test_an_option_that_cannot_be_is_told_by_its_flag(module, tmp_path, monkeypatch, capsys):
    assert ended(monkeypatch, module, "--out", str(tmp_path), "--workers", "-1") == 2
    assert capsys.readouterr().err == "error: --workers: got -1; allowed: >= 0. Choose another.\n"


# ---------------------------------------------------------------- sources


@pytest.fixture
def sources(monkeypatch):
    volumes = [CtVolume(np.zeros((24, 8, 8), np.int16), (5.0, 1.0, 1.0), f"scan_{k}") for k in range(3)]
    rooms = [Environment(np.ones((4, 8, 3), np.float32), name) for name in ("hall", "park")]
    monkeypatch.setattr("data_gen.sources.load_volumes", lambda folder: volumes)
    monkeypatch.setattr("data_gen.sources.load_environments", lambda folder: rooms)
    loaded.cache_clear()
    yield SourceConfig(ct=Path("ct"), hdri=Path("hdri"), real_share=1.0)
    loaded.cache_clear()


def drawn(config):
    rng = np.random.default_rng(0)
    pairs = [(draw_volume(config, rng).name, draw_environment(config, rng).name) for _ in range(40)]
    return {name for pair in pairs for name in pair}


@pytest.fixture
def scan_and_stub(tmp_path):
    """A folder with a scan and with a stub of two slices, too few to print a film."""
    for name, slices in (("scan", 24), ("stub", 2)):
        hu = np.zeros((slices, 8, 8), np.int16)
        hu[:, 2:6, 2:6] = 1000
        np.savez(tmp_path / f"{name}.npz", hu=hu, spacing_mm=np.array([5.0, 1.0, 1.0]))
    loaded.cache_clear()
    yield tmp_path
    loaded.cache_clear()


def test_what_is_left_out_of_a_folder_is_told(simple, scan_and_stub, tmp_path_factory, capsys):
    out = tmp_path_factory.mktemp("data")
    generate(simple_config(out, count=1, sources=SourceConfig(ct=scan_and_stub)))
    told = f"1 of the CT sources in {scan_and_stub} is left out:\n  stub: fewer than 3 slices\n"
    assert told in capsys.readouterr().err


def test_what_workers_leave_out_is_told_by_them_once_asked(scan_and_stub, capfd):
    with workers(1, None) as those:
        volumes, told = next(those.in_order(with_left_out, [(load_volumes, scan_and_stub)]))
        next(those.in_order(load_volumes, [(scan_and_stub,)]))
    assert [volume.name for volume in volumes] == ["scan"]
    assert told == [f"1 of the CT sources in {scan_and_stub} is left out:\n  stub: fewer than 3 slices"]
    assert "left out" not in capfd.readouterr().err


def test_what_is_held_out_is_what_the_others_are_not_made_from(sources):
    held_out = ("scan_1", "park")
    rest, test = replace(sources, leave_out=held_out), replace(sources, only=held_out)
    assert drawn(test) == set(held_out)
    assert drawn(rest) == {"scan_0", "scan_2", "hall"}
    assert drawn(replace(sources, only=("scan_*", "h*"), leave_out=("*_0",))) == {"scan_1", "scan_2", "hall"}


def test_a_name_that_nothing_has_is_refused(sources):
    """A typing error must not let a test scan into the training data."""
    with pytest.raises(ConfigError, match=r"scan_7.*allowed: scan_0, scan_1, scan_2, hall, park"):
        loaded(replace(sources, leave_out=("scan_7",)))


def test_leaving_out_all_is_refused(sources):
    with pytest.raises(ConfigError, match="--hdri"):
        loaded(replace(sources, only=("scan_*",)))


def test_phantoms_of_different_ranges_differ():
    rng = np.random.default_rng(0)
    one, other = (draw_volume(SourceConfig(phantoms=(k, k + 1)), np.random.default_rng(5)) for k in (0, 1))
    assert not np.array_equal(one.hu, other.hu)
    with pytest.raises(ConfigError, match="phantom"):
        draw_volume(SourceConfig(phantoms=(3, 3)), rng)


@pytest.mark.parametrize("name", ["ct", "hdri"])
def test_a_folder_that_is_not_there_is_refused(name):
    with pytest.raises(DataError, match="nowhere"):
        loaded(SourceConfig(**{name: Path("nowhere")}))


def test_a_folder_that_may_not_be_read_is_refused(tmp_path, monkeypatch):
    def denied(folder):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(folder))

    monkeypatch.setattr("data_gen.sources.load_volumes", denied)
    with pytest.raises(DataError, match="Permission denied"):
        loaded(SourceConfig(ct=tmp_path))
