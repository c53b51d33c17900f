"""The examples run, on a small dataset, from beginning to end."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "python" / "examples"


def run(*arguments: object, **environment: str) -> str:
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | environment, cwd=EXAMPLES)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize(
    ("name", "arguments", "told"),
    [
        ("predictor.py", ["{}", 10], "agent"),
        ("dqn.py", ["--dataset", "{}", "--total-timesteps", 320, "--learning-starts", 100, "--starts", 5], "agent"),
        ("maskable_ppo.py", ["{}", 256], "of 100 episodes found a coverage hole"),
    ],
)
def test_programs_run(sanjose: Path, name: str, arguments: list[object], told: str) -> None:
    assert told in run(EXAMPLES / name, *(str(sanjose) if argument == "{}" else argument for argument in arguments))


def test_the_notebook_runs(sanjose: Path, tmp_path: Path) -> None:
    """All of its cells, as a program; what they draw is drawn to memory."""
    notebook = json.loads((EXAMPLES / "first_steps.ipynb").read_text())
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] for cell in notebook["cells"] if cell["cell_type"] == "code"), "no outputs are kept"
    program = tmp_path / "notebook.py"
    program.write_text("\n".join([*cells, "plt.savefig('/dev/null', format='png')"]))
    assert "holes of" in run(program, DATASET=str(sanjose), MPLBACKEND="agg")


def test_lines_of_the_readme_run(sanjose: Path, tmp_path: Path) -> None:
    text = (EXAMPLES.parent / "README.md").read_text()
    program = tmp_path / "readme.py"
    code = text.split("```python\n")[1].split("```")[0]
    program.write_text(code.replace("datasets/sanjose-1.0.0", str(sanjose)))
    run(program)
