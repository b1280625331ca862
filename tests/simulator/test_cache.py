"""Kernels run wherever the user may write, and also if that is nowhere."""

import os
import shutil
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NOWHERE = "/dev/null/nowhere"
CODE = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from mapf_pz.instances import components
components(np.ones((3, 3), np.bool_))
values = [v for name, m in list(sys.modules.items()) if name.startswith("mapf_pz.") for v in vars(m).values()]
print(any(kernel.stats.cache_hits for kernel in values if isinstance(kernel, Dispatcher)))
"""
# Another user, who may read everything: the tests may run where only root may read.
STRANGER = [
    *("setpriv", "--reuid=54321", "--regid=54321", "--clear-groups"),
    *("--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search"),
]


def run(code=CODE, prefix=(), **environment):
    """Return what a process prints, and its warnings; nothing says where it may write but `environment`."""
    kept = {name: value for name, value in os.environ.items() if name not in ("HOME", "XDG_CACHE_HOME")}
    command = [*prefix, sys.executable, "-c", code]
    result = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env={**kept, **environment})
    assert result.returncode == 0, result.stderr
    return result.stdout.strip(), [line for line in result.stderr.splitlines() if "Warning" in line]


@pytest.mark.slow
@pytest.mark.parametrize("variable", ["HOME", "NUMBA_CACHE_DIR"])
def test_without_a_cache_folder_a_private_one_is_used(tmp_path, variable):
    private = tmp_path / f"mapf_pz-{os.getuid()}"
    for was_cached in ("False", "True"):
        found, warned = run(TMPDIR=str(tmp_path), **{variable: NOWHERE})
        assert found == was_cached
        assert len(warned) == 1
        assert f"compiled kernels are cached in {private}: " in warned[0]
        assert "NUMBA_CACHE_DIR" in warned[0]
    assert stat.S_IMODE(private.stat().st_mode) == 0o700


@pytest.mark.slow
def test_a_temporary_folder_that_others_write_to_is_not_used(tmp_path):
    private = tmp_path / f"mapf_pz-{os.getuid()}"
    private.mkdir()
    private.chmod(0o777)
    _, warned = run(TMPDIR=str(tmp_path), HOME=NOWHERE)
    assert "compiled kernels are cached in " in warned[0]
    assert f"{private}: " not in warned[0]
    assert not any(private.iterdir())
    assert len(list(tmp_path.iterdir())) == 2


def test_a_process_that_can_write_nowhere_caches_nothing():
    code = f"import tempfile; tempfile.tempdir = {NOWHERE!r}\n" + CODE
    found, warned = run(code, HOME=NOWHERE)
    assert found == "False"
    assert len(warned) == 1
    assert "compiled kernels are not cached: " in warned[0]


@pytest.mark.slow
def test_a_user_without_a_home_in_an_installation_of_another():
    if os.getuid() != 0 or not shutil.which("setpriv") or subprocess.run([*STRANGER, "true"], check=False).returncode:
        pytest.skip("only root may become another user")
    with tempfile.TemporaryDirectory() as folder:  # pytest's own are closed to other users
        Path(folder).chmod(0o1777)
        for was_cached in ("False", "True"):
            found, warned = run(prefix=STRANGER, TMPDIR=folder)
            assert found == was_cached
            assert len(warned) == 1
            assert f"{folder}/mapf_pz-54321: Could not determine home directory" in warned[0]
