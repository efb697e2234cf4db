"""Shows how a training goes: a line per validation on the terminal, the same numbers as CSV and picture and for
TensorBoard, and a warning when nothing is learnt."""

from __future__ import annotations

import csv
import io
import math
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Self

from tqdm import tqdm

from embodied_depth_trainer import processes
from embodied_depth_trainer.data.pairs import Pairs
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.files import write_atomically
from embodied_depth_trainer.training.tensorboard import Board
from embodied_depth_trainer.training.trainer import Trainer
from embodied_depth_trainer.training.validation import Measured, Validation, Verdict, verdict

CSV_FILE = "progress.csv"
PICTURE_FILE = "progress.png"
# The warning comes after this share of the steps if no validation has shown any gain: in the beginning the
# statistics of batch norms lag behind the weights, and validation losses of random networks rise first.
WARN_AFTER = 0.5
# Validations of a training, unless another interval is given.
VALIDATIONS = 10

Row = dict[str, float]
"""The numbers of one validation by their names; the names are the columns of the CSV file."""


class Progress:
    """Watches a training. It is called after each step; see `train`."""

    def __init__(
        self,
        trainer: Trainer,
        validation: Pairs,
        steps: int,
        out: Path,
        every: int | None = None,
        board: Board | None = None,
    ) -> None:
        """`steps` is the total number of steps, `every` the steps between two validations. The trainer's network is
        the initial one, with which every later one is compared."""
        self.trainer = trainer
        self.steps = steps
        self.out = out
        self.every = max(1, every or steps // VALIDATIONS)
        self.board = board
        self.is_first_process = processes.rank() == 0
        self.validation = Validation(validation)
        self.rows: list[Row] = []
        self.has_gained = False
        self.warned = False
        self.losses: list[float] = []
        self.verdict: Verdict | None = None
        self.since = time.perf_counter()
        self.bar = tqdm(total=steps, unit="step", disable=None if self.is_first_process else True)
        self.initial = self.validation.measure(trainer) if len(self.validation) else None
        if self.initial is None:
            self._say("no validation: no frame to measure is in a held-out place; drive through more places")

    def __enter__(self) -> Self:
        self.since = time.perf_counter()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.bar.close()
        if self.board is not None:
            self.board.close()
        if kind is None and self.verdict is not None:
            self._say(str(self.verdict))

    def __call__(self, step: int, loss: float) -> None:
        """Records a step."""
        if not self.rows:
            self._begin(step)
        self.losses.append(loss)
        if self.board is not None:
            self.board.record(step, loss)
        self.bar.n = step
        self.bar.set_postfix(loss=f"{loss:.4f}", refresh=False)
        self.bar.update(0)
        if step % self.every == 0 or step == self.steps:
            self._report(step)

    def _begin(self, step: int) -> None:
        """Writes the row of the initial network, or keeps those of the interrupted training."""
        first = self._row(0, math.nan, self.initial, math.nan)
        earlier = [row for row in _read(self.out / CSV_FILE, list(first)) if row["step"] < step]
        self.rows = earlier or [first]
        self._say(_header(first))
        if not earlier:
            self._say(_line(first))

    def _report(self, step: int) -> None:
        speed = len(self.losses) * self.trainer.settings.batch / max(time.perf_counter() - self.since, 1e-9)
        now = self.validation.measure(self.trainer) if self.initial is not None else None
        row = self._row(step, sum(self.losses) / len(self.losses), now, speed)
        self.rows.append(row)
        self._say(_line(row))
        if self.initial is not None and now is not None:
            self.verdict = verdict(self.initial, now)
            self.has_gained |= not self.verdict.is_nothing
            if not self.has_gained and not self.warned and WARN_AFTER * self.steps <= step < self.steps:
                self.warned = True
                self._say(f"step {step} of {self.steps}: {self.verdict}")
        if self.is_first_process:
            _write(self.rows, self.out / CSV_FILE)
            if self.board is not None:
                self.board.report(step, {name: value for name, value in row.items() if name != "step"})
        self.losses = []
        self.since = time.perf_counter()

    def _row(self, step: int, loss: float, measured: Measured | None, speed: float) -> Row:
        row = {"step": float(step), "loss": loss}
        if measured is not None:
            row["validation"] = measured.loss
            row |= {f"validation: {name}": part for name, part in measured.parts.items()}
            row |= {"right": measured.right, "right in holes": measured.right_in_holes}
        rate = self.trainer.settings.learning_rate_at(max(0, step - 1))
        return {**row, "learning rate": rate, "samples per second": speed}

    def _say(self, text: str) -> None:
        if self.is_first_process:
            tqdm.write(text, file=sys.stderr)


def _header(row: Row) -> str:
    return " ".join(f"{_short(name):>{_width(name)}}" for name in row)


def _line(row: Row) -> str:
    return " ".join(f"{_number(name, value):>{_width(name)}}" for name, value in row.items())


def _short(name: str) -> str:
    return name.removeprefix("validation: ").replace("samples per second", "samples/s")


def _width(name: str) -> int:
    return max(len(_short(name)), 7)


def _number(name: str, value: float) -> str:
    if math.isnan(value):
        return "-"
    digits = {"step": "d", "right": ".3f", "right in holes": ".3f", "learning rate": ".1e", "samples per second": ".1f"}
    return f"{int(value) if name == 'step' else value:{digits.get(name, '.4f')}}"


def _read(file: Path, names: list[str]) -> list[Row]:
    """The rows of an earlier part of the training; none if they have other columns or the file is damaged."""
    try:
        lines = list(csv.reader(io.StringIO(file.read_text())))
        rows = [dict(zip(names, map(float, line), strict=True)) for line in lines[1:]]
    except (OSError, ValueError):
        return []
    return rows if lines and lines[0] == names else []


def _write(rows: list[Row], file: Path) -> None:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(rows[0])
    table.writerows([f"{value:.6g}" for value in row.values()] for row in rows)
    write_atomically(text.getvalue().encode(), file)


def draw(folder: Path) -> Path:
    """Draws `progress.csv` of a training's directory as `progress.png`: losses with their parts, and right depth."""
    # Imported here because most trainings draw nothing.
    from matplotlib.figure import Figure

    file = folder / CSV_FILE
    try:
        rows = list(csv.DictReader(io.StringIO(file.read_text())))
    except OSError as problem:
        raise TrainerError(f"cannot read {file}: {problem}; train at least one step") from None
    figure = Figure((10, 4), layout="constrained")
    losses, right = figure.subplots(1, 2)
    for name in rows[0]:
        points = [(float(row["step"]), float(row[name])) for row in rows if row[name] != "nan"]
        is_loss = name == "loss" or name.startswith("validation")
        axis = losses if is_loss else right if name.startswith("right") else None
        if axis is not None and points:
            style = ":" if name.startswith("validation: ") else "-" if axis is right or name == "validation" else "--"
            axis.plot(*zip(*points, strict=True), style, label="training" if name == "loss" else name)
    losses.set(title="loss; dotted: its parts on held-out places", xlabel="steps")
    right.set(title="share within 25 % of the label, held-out places", xlabel="steps", ylim=(0, 1))
    for axis in (losses, right):
        axis.grid(alpha=0.3)
        if axis.lines:
            axis.legend(fontsize=8)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    write_atomically(stream.getvalue(), folder / PICTURE_FILE)
    return folder / PICTURE_FILE
