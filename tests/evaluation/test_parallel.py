import multiprocessing
import os
import signal
import subprocess
import sys
import time

import pytest

from mapf_pz._internal.parallel import run_jobs


def squared(number):
    return number**2


def process(_):
    return os.getpid()


def threads(_):
    return os.environ["OMP_NUM_THREADS"]


def fail(number):
    if number == 1:
        raise ValueError(f"number {number}: expected another")
    return number


def sleep(seconds):
    time.sleep(seconds)
    return seconds


def begin(parameters):
    jobs, file = parameters
    for number in run_jobs(sleep, [0, 0, 60, 60], jobs):
        with open(file, "a") as out:
            out.write(f"{number} ")


def wait_for(condition):
    while not condition():
        time.sleep(0.05)


def test_in_this_process():
    assert list(run_jobs(squared, [3, 1, 2], 1)) == [9, 1, 4]
    assert list(run_jobs(process, [0], 1)) == [os.getpid()]


def test_jobs_run_in_sequence():
    done = []
    running = run_jobs(done.append, [1, 2], 1)
    next(running)
    assert done == [1]


def test_in_processes(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    assert sorted(run_jobs(squared, range(20), 2)) == [number**2 for number in range(20)]
    workers = set(run_jobs(process, range(20), 2))
    assert os.getpid() not in workers
    assert len(workers) <= 2
    assert set(run_jobs(threads, [0], 2)) == {"1"}
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize("jobs", [1, 2])
def test_errors_are_raised_here(jobs):
    with pytest.raises(ValueError, match="number 1: expected another"):
        list(run_jobs(fail, range(5), jobs))
    assert multiprocessing.active_children() == []


def test_abandoned_jobs_are_not_awaited():
    running = run_jobs(sleep, [0, 10**6, 10**6], 2)
    assert next(running) == 0
    running.close()
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize("jobs", [2, "ray"])
def test_no_jobs_start_no_process(jobs, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert list(run_jobs(squared, [], jobs)) == []


@pytest.mark.parametrize("jobs", [0, -1, "rays", 1.5])
def test_other_numbers_are_refused(jobs):
    with pytest.raises(ValueError, match="expected a number of processes, 1 or more, or 'ray'"):
        run_jobs(squared, [1], jobs)


def test_ray_has_to_be_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError):
        list(run_jobs(squared, [1], "ray"))


@pytest.mark.slow
def test_errors_on_ray_are_raised_here(monkeypatch):
    ray = pytest.importorskip("ray")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    monkeypatch.setenv("RAY_worker_niceness", "0")  # on a busy machine, its workers would never get their turn

    def here(number):  # Ray's workers may not find this module
        if number == 7:
            raise ValueError("number 7: expected another")
        return number**2

    running = run_jobs(here, [3, 7], "ray")
    with pytest.raises(ValueError, match=r"^number 7: expected another$"):
        assert [next(running), next(running)] == [9]
    assert not ray.is_initialized()


def children_of(process_id):
    listed = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(process_id)], capture_output=True, text=True, check=False
    )
    return [int(word) for word in listed.stdout.split()]


def is_alive(process_id):
    try:
        with open(f"/proc/{process_id}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="looks up processes in /proc")
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL], ids=lambda sent: sent.name)
def test_no_process_is_left_behind(tmp_path, sent):
    file = tmp_path / "done"
    script = tmp_path / "script.py"
    script.write_text(
        f"from tests.evaluation.test_parallel import begin\nif __name__ == '__main__':\n    begin((2, {str(file)!r}))\n"
    )
    environment = os.environ | {"PYTHONPATH": os.getcwd()}
    with subprocess.Popen([sys.executable, script], env=environment, stderr=subprocess.PIPE, text=True) as running:
        wait_for(lambda: (file.exists() and file.read_text() == "0 0 ") or running.poll() is not None)
        workers = children_of(running.pid)
        assert len(workers) >= 2
        running.send_signal(sent)
        _, errors = running.communicate()
    assert "semaphore" not in errors
    wait_for(lambda: not any(map(is_alive, workers)))
