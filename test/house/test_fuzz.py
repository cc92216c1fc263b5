# SPDX-License-Identifier: Apache-2.0
"""Each way in takes inputs that nobody intended, or refuses them in words (all of it: `make fuzz`)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.__main__ import Failed, check, fuzz, targets
from fuzz.target import Target


@pytest.mark.parametrize("name", sorted(targets()))
def test_the_seeds_are_taken(name: str, tmp_path: Path) -> None:
    """Mutations of what is refused would test nothing but the first check."""
    target = targets()[name](tmp_path)
    assert all(check(target, seed) for seed in target.seeds)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(targets()))
def test_nothing_but_a_refusal_in_words(name: str, repository: Path) -> None:
    """In a process of its own, since its memory is limited."""
    command = [sys.executable, "-m", "fuzz", "--inputs", "1000", "--minutes", "0.5", name]
    ran = subprocess.run(command, cwd=repository, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_a_defect_is_found(tmp_path: Path) -> None:
    """A reader that fails at one value, which no seed has, is caught within a few hundred inputs."""

    class Careless(Target):
        name = ""

        def make_seeds(self) -> list[bytes]:
            return [b"load,1\n"]

        def run(self, data: bytes) -> list[float]:
            digits = data.split(b",")[-1].strip()
            try:
                return [float(digits)]
            except ValueError:
                return []

    with pytest.raises(Failed, match="came out"):
        fuzz(Careless(tmp_path), 300, 20.0)
