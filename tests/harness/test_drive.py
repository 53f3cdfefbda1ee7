"""The road every run takes, driven with a kind of run that only counts; and the lookup that tells a folder's kind."""

from __future__ import annotations

import json
from dataclasses import dataclass

import pytest
import yaml
from made_rows import make_move_rows, make_rows

from toolkit.errors import ToolkitError
from toolkit.harness.ablate import Ablation
from toolkit.harness.drive import drive, kind_of
from toolkit.harness.experiment import expand, load_experiment
from toolkit.harness.kinds import RunKind, SceneTask, Work
from toolkit.harness.rearrange import Rearrangement
from toolkit.harness.runs import RunOptions, Shard, resolve
from toolkit.progress import Progress
from toolkit.results.completion import MoveRow
from toolkit.results.rows import ObjectRow, Row, read_rows_as, write_rows


@dataclass(frozen=True)
class CellCount:
    """A summary."""

    cell: str
    rows: int


class Counting(RunKind[ObjectRow, SceneTask]):
    """Two rows for every scene and cell, with the scenes begun from the last one."""

    doing = "Counting"
    row = ObjectRow

    def __init__(self):
        self.ran: list[tuple[str, int]] = []

    def check(self, cell):
        return {f"weights of {cell.name}": "0" * 64}

    def work(self, job):
        scenes = filter(job.shard.holds, reversed(range(job.cells[0].dataset["scenes"])))
        pending = {scene: job.pending(job.cells, scene) for scene in scenes}
        return Work([SceneTask(i, cells, job.cache) for i, cells in pending.items() if cells], [{"made": "up"}])

    def run_scene(self, task):
        self.ran += [(cell.name, task.scene_id) for cell in task.cells]
        about = {"settings": {}, "scene": "", "object_name": "nothing", "symmetry": "none", "scene_id": task.scene_id}
        return [ObjectRow(cell=cell.name, object=i, **about) for cell in task.cells for i in (1, 0)]

    def summarize(self, rows):
        cells = dict.fromkeys(row.cell for row in rows)
        return [CellCount(cell, sum(row.cell == cell for row in rows)) for cell in cells]

    def print(self, run, console):
        console.print(run)

    def write_page(self, run):
        (run / "report.html").write_text("counted")
        return run / "report.html"


CELLS = ["views=all", "views=1"]


@pytest.fixture
def experiment():
    """Three scenes in two cells."""
    changes = {"dataset.scenes": [3], "dataset.rotation_deg": [60], "pipeline.views": ["all", 1]}
    return load_experiment("quick", changes)


def places(run):
    return [(row.cell, row.scene_id, row.object) for row in read_rows_as(ObjectRow, run / "rows.jsonl")]


WHOLE = [(cell, scene, number) for cell in CELLS for scene in range(3) for number in (0, 1)]


class Seen(Progress):
    """Adds up what the bars show."""

    def __init__(self):
        super().__init__()
        self.bars: dict[str, list[int]] = {}

    def step(self, title, total):
        self.bars[title] = [0, total]
        return super().step(title, total)


def test_any_kind_of_run_leaves_the_same_files_and_its_rows_in_order(experiment, tmp_path):
    seen = Seen()
    run = drive(Counting(), experiment, RunOptions(out=tmp_path / "run"), seen)
    assert places(run) == WHOLE
    assert (run / "summary.csv").read_text().splitlines() == ["cell,rows", "views=all,6", "views=1,6"]
    assert (run / "report.html").read_text() == "counted"
    meta = json.loads((run / "meta.json").read_text())
    assert meta["experiment"]["title"] == experiment.title == "views: all or 1"
    assert set(meta["weights"]) == {f"weights of {cell}" for cell in CELLS} and meta["datasets"] == [{"made": "up"}]
    resolved = yaml.safe_load((run / "experiment.resolved.yaml").read_text())
    assert resolved == resolve("quick", [cell.resolved() for cell in expand(experiment)])
    assert seen.bars["Counting"][1] == len(CELLS) * 3


def test_what_is_done_already_is_not_done_again(experiment, tmp_path):
    run = drive(Counting(), experiment, RunOptions(out=tmp_path / "run"))
    rows = (run / "rows.jsonl").read_text().splitlines()
    # Killed while it wrote: the last pair there is may lack rows.
    (run / "rows.jsonl").write_text("\n".join(rows[:5]) + "\n")
    again = Counting()
    drive(again, experiment, RunOptions(out=run, resume=True))
    assert places(run) == WHOLE
    assert set(again.ran) == {(cell, scene) for cell, scene, _ in WHOLE} - {("views=all", 0), ("views=all", 1)}


@pytest.mark.parametrize("shard", [Shard(1, 2), Shard(2, 2), Shard(3, 3)])
def test_a_shard_is_of_its_scenes_only(shard, experiment, tmp_path):
    run = drive(Counting(), experiment, RunOptions(out=tmp_path / "run", shard=shard))
    assert places(run) == [place for place in WHOLE if shard.holds(place[1])]


def test_a_shard_without_scenes_is_refused_before_any_work(experiment, tmp_path):
    with pytest.raises(ToolkitError, match="fewer scenes than shards"):
        drive(Counting(), experiment, RunOptions(out=tmp_path / "run", shard=Shard(4, 4)))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("kind", "name"), [(Ablation(), "rearrange"), (Rearrangement(), "quick")])
def test_each_kind_sends_the_other_s_experiments_on(kind, name, tmp_path):
    with pytest.raises(ToolkitError, match=r"run it with `toolkit (rearrange|ablate)`"):
        drive(kind, load_experiment(name), RunOptions(out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


# The lookup


@pytest.mark.usefixtures("no_plots")
@pytest.mark.parametrize(
    ("name", "kind", "row", "rows"),
    [
        ("quick", Ablation, Row, make_rows("a", 0.5)),
        ("masks", Ablation, Row, make_rows("a", 0.5)),
        ("rearrange", Rearrangement, MoveRow, make_move_rows("a", 0.5)),
        ("arm", Rearrangement, MoveRow, make_move_rows("a", 0.5)),
        (None, Ablation, Row, make_rows("a", 0.5)),
    ],
)
def test_a_folder_s_kind_is_looked_up_and_reads_its_rows(name, kind, row, rows, tmp_path):
    if name is not None:
        resolved = resolve(name, [cell.resolved() for cell in expand(load_experiment(name))], Shard(1, 2))
        (tmp_path / "experiment.resolved.yaml").write_text(yaml.safe_dump(resolved))
    write_rows(tmp_path / "rows.jsonl", rows)
    found = kind_of(tmp_path)
    assert type(found) is kind and found.row is row
    assert read_rows_as(found.row, tmp_path / "rows.jsonl") == rows
    (summary,) = found.summarize(rows)
    assert summary.cell == "a" and summary.objects == len(rows)
    assert found.write_page(tmp_path) == tmp_path / "report.html"


@pytest.mark.parametrize("text", ["cells: [", "- a list", "\x00"])
def test_a_folder_whose_settings_cannot_be_read_is_one_sentence(text, tmp_path):
    (tmp_path / "experiment.resolved.yaml").write_text(text)
    with pytest.raises(ToolkitError, match=r"experiment\.resolved\.yaml") as error:
        kind_of(tmp_path)
    assert "\n" not in str(error.value)
