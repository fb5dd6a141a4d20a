"""Where compiled kernels are kept, and that what the user has set is left alone."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from service import kernel_cache


def test_the_users_own_settings_stay(tmp_path: Path):
    environment = {
        "NUMBA_CACHE_DIR": str(tmp_path),
        "OMP_NUM_THREADS": "4",
        "NUMBA_OPT": "3",
        "NUMBA_LOOP_VECTORIZE": "1",
    }

    kernel_cache.prepare(environment)

    assert environment["NUMBA_CACHE_DIR"] == str(tmp_path)
    assert environment["OMP_NUM_THREADS"] == "4"
    assert environment["OPENBLAS_NUM_THREADS"] == "1"
    assert environment["NUMBA_OPT"] == "3"
    assert environment["NUMBA_LOOP_VECTORIZE"] == "1"


def test_kernels_are_optimised_at_level_1_unless_told_otherwise(tmp_path: Path):
    environment = {"NUMBA_CACHE_DIR": str(tmp_path)}

    kernel_cache.prepare(environment)

    assert environment["NUMBA_OPT"] == "1"
    assert environment["NUMBA_LOOP_VECTORIZE"] == "0"


def test_wayside_kernel_cache_names_the_directory(tmp_path: Path):
    environment = {"WAYSIDE_KERNEL_CACHE": str(tmp_path / "kernels")}

    kernel_cache.prepare(environment)

    assert environment["NUMBA_CACHE_DIR"] == str(tmp_path / "kernels")


def test_the_default_lies_in_the_users_cache_directory(tmp_path: Path):
    environment = {"XDG_CACHE_HOME": str(tmp_path)}

    kernel_cache.prepare(environment)

    assert environment["NUMBA_CACHE_DIR"] == str(tmp_path / "wayside" / "kernels")
    assert (tmp_path / "wayside" / "kernels").is_dir()


def test_a_user_without_a_home_gets_a_private_temporary_directory(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    not_a_directory = tmp_path / "file"
    not_a_directory.touch()
    environment = {"XDG_CACHE_HOME": str(not_a_directory)}

    kernel_cache.prepare(environment)

    directory = Path(environment["NUMBA_CACHE_DIR"])
    assert directory == tmp_path / f"wayside-kernels-{os.getuid()}"
    assert directory.stat().st_mode & 0o077 == 0


def test_a_temporary_directory_that_others_can_write_is_not_used(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    planted = tmp_path / f"wayside-kernels-{os.getuid()}"
    planted.mkdir()
    planted.chmod(0o777)
    not_a_directory = tmp_path / "file"
    not_a_directory.touch()
    environment = {"XDG_CACHE_HOME": str(not_a_directory)}

    kernel_cache.prepare(environment)

    assert Path(environment["NUMBA_CACHE_DIR"]) != planted
    assert Path(environment["NUMBA_CACHE_DIR"]).is_dir()


def test_importing_the_package_imports_no_numerical_library():
    loaded = "import sys, service; print([m for m in ('numpy', 'numba', 'scipy') if m in sys.modules])"

    result = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)

    assert result.stdout.strip() == "[]"
