"""convert --up on a groom that moves: every frame is turned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from click.testing import CliRunner

from detangled.axes import turned_vectors
from detangled.formats.frames import read_frames, write_frames
from detangled.groom import Groom
from detangled_cli.main import detangled


def test_every_frame_is_turned(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    frames = [rng.normal(size=(7, 3)).astype(np.float32).astype(np.float64) for _ in range(3)]
    groom = Groom(frames[0], np.array([0, 4, 7]), unit_cm=1.0)
    write_frames(groom, [0.0, 0.1, 0.2], frames, tmp_path / "a.abc")
    words = ["convert", str(tmp_path / "a.abc"), str(tmp_path / "b.abc"), "--unit", "cm", "--in-up", "z", "--up", "y"]
    result = CliRunner().invoke(detangled, words, prog_name="detangled")
    assert result.exit_code == 0, result.output
    back = read_frames(tmp_path / "b.abc", unit="cm")
    assert len(back) == 3
    for found, frame in zip(back, frames, strict=True):
        np.testing.assert_array_equal(found, turned_vectors(frame, "z", "y"))
