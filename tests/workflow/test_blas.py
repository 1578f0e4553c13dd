"""Every stage asks for the same OpenBLAS kernels, before NumPy is loaded."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pointnetkl.workflow import blas

SCRIPTS = sorted((Path(__file__).parents[2] / "pipeline").glob("*.py"))
CODE = "import sys, os, pointnetkl.workflow.blas; print(os.environ.get('OPENBLAS_CORETYPE'), 'numpy' in sys.modules)"


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_imports_blas_before_what_could_load_numpy(script: Path):
    imports = (node for node in ast.parse(script.read_text()).body if isinstance(node, ast.Import | ast.ImportFrom))
    names = [ast.unparse(node) for node in imports if ast.unparse(node) != "import os"]
    assert names[0] == "import pointnetkl.workflow.blas"


@pytest.mark.skipif(not blas.has_avx2(), reason="the processor cannot run the Haswell kernels")
def test_the_kernels_are_haswell_s_unless_the_user_chose_others():
    environment = {key: value for key, value in os.environ.items() if key != "OPENBLAS_CORETYPE"}
    for chosen, kernels in (({}, "Haswell"), ({"OPENBLAS_CORETYPE": "Zen"}, "Zen")):
        done = subprocess.run([sys.executable, "-c", CODE], env=environment | chosen, capture_output=True, text=True)
        assert done.stdout.split() == [kernels, "False"], done.stderr


def test_a_processor_without_avx2_keeps_its_own_kernels(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    (tmp_path / "cpuinfo").write_text("flags : sse2 avx\n")
    monkeypatch.setattr(blas, "_CPUINFO", tmp_path / "cpuinfo")
    assert not blas.has_avx2()
