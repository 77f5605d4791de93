"""A batch killed with SIGKILL and resumed: the outputs of an undisturbed run, each tile once."""

import kill_test
import pytest


@pytest.fixture(scope="module")
def calm(tmp_path_factory):
    """Tiles, and the outputs of a run in peace."""
    folder = tmp_path_factory.mktemp("batch")
    tiles = kill_test.make_tiles(folder / "tiles", 20, n_points=3000)
    story = kill_test.run_with_kills(tiles, folder / "calm", n_kills=0, options=OPTIONS)
    assert story.faults == []
    return tiles, folder


OPTIONS = (*kill_test.OPTIONS, "--no-dem", "--meta", "none")


@pytest.mark.parametrize("seed", [1, 2])
def test_killed_and_resumed_is_as_if_nothing_had_happened(calm, seed):
    tiles, folder = calm
    out = folder / f"killed{seed}"
    story = kill_test.run_with_kills(tiles, out, n_kills=2, seed=seed, options=OPTIONS)
    assert story.kills, "none came in time"
    assert story.faults == []
    assert kill_test.differences(folder / "calm", out) == []
    assert story.peak_parent_bytes < 300e6


def test_the_judge_sees_what_is_wrong(calm, tmp_path):
    tiles, folder = calm
    story = kill_test.Story()
    out = tmp_path / "out"
    out.mkdir()
    (out / ".half.tmp").touch()
    manifest = tmp_path / "run.jsonl"
    lines = (folder / "calm.jsonl").read_text().splitlines(keepends=True)
    manifest.write_text("".join(lines[:-1]) + lines[0] + "{torn\n")
    kill_test._judge(tiles, out, manifest, story)
    assert len(story.faults) == 4  # damaged, one tile without a record, one with two, a leftover
    assert len(kill_test.differences(folder / "calm", out)) == 20 * 3 + 1
