# SPDX-License-Identifier: Apache-2.0
"""Many training runs (seeds x models x settings) through joblib, here or on a Ray cluster.

Every run has a folder of its own with its checkpoint, history and policy, so that finished runs are
skipped when a sweep is started again and one that fails takes no other with it. The machines of a
cluster must see the rigs and the output folder under the same paths.
"""

import contextlib
import hashlib
import itertools
import re
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from pneu_common.errors import InputError
from pneu_policy.learn.history import History, Row
from pneu_policy.learn.settings import TrainSettings
from pneu_policy.learn.trainer import CHECKPOINT, HISTORY, POLICY, Trainer, first_difference

BACKENDS = ("loky", "ray")


@dataclass(frozen=True)
class Workers:
    """Where runs are trained.

    Attributes:
        backend: ``loky``, processes of this machine, or ``ray``, a Ray cluster.
        workers: Runs at a time; -1 takes as many as there are cores.
        address: Address of the Ray cluster; None joins the one that Ray finds, or starts one.
    """

    backend: str = "loky"
    workers: int = 1
    address: str | None = None

    def __post_init__(self) -> None:
        """Raises InputError where a value is out of range."""
        if self.backend not in BACKENDS:
            raise InputError(f"backend: found {self.backend!r}, allowed are {', '.join(BACKENDS)}")
        if self.workers != -1 and self.workers < 1:
            raise InputError(f"workers: found {self.workers}, allowed is 1 or more, or -1")

    @classmethod
    def from_dict(cls, mapping: Mapping[str, Any]) -> "Workers":
        """Reads plain values.

        Args:
            mapping: Values by field.

        Raises:
            InputError: A field is unknown or wrong.
        """
        known = [f.name for f in fields(cls)]
        for name, value in mapping.items():
            if name not in known:
                raise InputError(f"run.{name}: is not a setting; known are {', '.join(known)}")
            if name == "workers" and (not isinstance(value, int) or isinstance(value, bool)):
                raise InputError(f"run.workers: found {value!r}, a whole number is needed")
            if name != "workers" and not (isinstance(value, str) or value is None):
                raise InputError(f"run.{name}: found {value!r}, text is needed")
        return cls(**mapping)


@dataclass(frozen=True)
class Run:
    """One run of a sweep.

    Attributes:
        folder: Where its files are.
        settings: What is trained.
    """

    folder: Path
    settings: TrainSettings

    @property
    def name(self) -> str:
        """Name of its folder."""
        return self.folder.name

    def made(self, training: Mapping[str, Any]) -> bool:
        """Whether a policy was trained as this run asks, on the file of the plant as it is.

        What came to the settings since is as it was, where a policy does not say otherwise.

        Args:
            training: What the policy's file says of its training.
        """
        try:
            settings = TrainSettings(**training["settings"])
        except (InputError, KeyError, TypeError):
            return False
        source = training.get("rig") or training.get("hand") or {}
        now = hashlib.sha256(Path(self.settings.env.file).read_bytes()).hexdigest()
        return bool(settings == self.settings and source.get("sha256") == now)

    def history(self) -> History | None:
        """The history of a run that is finished, or None.

        Raises:
            InputError: The folder holds a finished run of other settings.
        """
        path = self.folder / HISTORY
        if not path.exists() or not (self.folder / POLICY).exists():
            return None
        history = History.load(path)
        wanted = self.settings.plain()
        longer = history.settings.get("iterations", 0) < wanted["iterations"]
        but = ("iterations",) if longer else ()
        other = first_difference(history.settings, wanted, but)
        if other:
            raise InputError(f"{path}: holds a run of other settings: {other}")
        return history if history.finished and not longer else None


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        run: The run.
        history: Its history; None where it failed.
        fault: What went wrong, as one line, or None.
        trace: The traceback of that.
    """

    run: Run
    history: History | None
    fault: str | None = None
    trace: str | None = None


def expand(document: Mapping[str, Any], folder: Path) -> list[Run]:
    """The runs that a settings document asks for.

    Args:
        document: Fields of `TrainSettings`, and under ``sweep`` dotted fields with the values to
            take; without it, it is one run, in the folder itself.
        folder: Where the runs' folders are.

    Raises:
        InputError: A field is wrong; the message names it.
    """
    base = {key: value for key, value in document.items() if key not in ("sweep", "run")}
    axes = document.get("sweep") or {}
    if not isinstance(axes, Mapping) or not all(isinstance(v, list) and v for v in axes.values()):
        raise InputError(f"sweep: found {axes!r}, needed are fields with lists of values")
    if not axes:
        return [Run(folder, TrainSettings(**base))]
    runs = []
    for values in itertools.product(*axes.values()):
        settings, name = base, []
        for path, value in zip(axes, values, strict=True):
            settings = _with(settings, str(path).split("."), value, str(path))
            name.append(f"{str(path).rpartition('.')[2]}-{_word(value)}")
        runs.append(Run(folder / "_".join(name), TrainSettings(**settings)))
    doubled = {run.name for run in runs if sum(run.name == other.name for other in runs) > 1}
    if doubled:
        raise InputError(f"sweep: two runs would be named {sorted(doubled)[0]!r}")
    return runs


def train(run: Run, resume: bool = True, report: Callable[[Row], None] | None = None) -> History:
    """Trains one run in this process.

    Args:
        run: The run.
        resume: Whether it goes on from its checkpoint, where there is one.
        report: Called with each row of the history.

    Returns:
        Its history.

    Raises:
        InputError: Settings or checkpoint cannot be used.
        KeyboardInterrupt: After a clean end by Ctrl-C.
    """
    run.folder.mkdir(parents=True, exist_ok=True)
    trainer = Trainer(run.settings)
    checkpoint = run.folder / CHECKPOINT
    if resume and checkpoint.exists():
        trainer.resume(checkpoint)
    return trainer.run(run.folder, report)


def train_all(runs: Sequence[Run], workers: Workers, resume: bool = True) -> Iterator[Outcome]:
    """Trains runs side by side and yields how each ended, in the order in which they end.

    Args:
        runs: The runs.
        workers: Where they are trained.
        resume: Whether they go on from their checkpoints.

    Raises:
        InputError: The backend is not installed or not to be reached.
    """
    todo = []
    for run in runs:
        history = run.history()
        if history is None:
            todo.append(run)
        else:
            yield Outcome(run, history)
    if not todo:
        return
    if workers.backend == "ray":
        _join_ray(workers.address)
    # Ray's backend hands results back all at once, and its cluster decides on threads.
    local: dict[str, Any] = {"inner_max_num_threads": 1} if workers.backend == "loky" else {}
    order = "generator_unordered" if workers.backend == "loky" else "list"
    left = {run.folder: run for run in todo}
    with joblib.parallel_config(backend=workers.backend, n_jobs=workers.workers, **local):
        parallel = joblib.Parallel(return_as=order, batch_size=1, pre_dispatch="all")
        try:
            here = Path.cwd()
            for outcome in parallel(joblib.delayed(_attempt)(run, resume, here) for run in todo):
                del left[outcome.run.folder]
                yield outcome
        except TerminatedWorkerError as error:
            # such as one that was killed for its memory; joblib then gives the others up as well
            fault = f"ended with a worker process that died ({error}); --resume goes on from here"
            for run in left.values():
                yield Outcome(run, None, " ".join(fault.split()), traceback.format_exc())


def _attempt(run: Run, resume: bool, where: Path) -> Outcome:
    """A run whose failure is told rather than raised, because it would end the others."""
    try:
        with contextlib.chdir(where):  # relative paths mean the same on every machine
            return Outcome(run, train(run, resume))
    except Exception as error:
        fault = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        return Outcome(run, None, " ".join(fault.split()), traceback.format_exc())


def _join_ray(address: str | None) -> None:
    try:
        import ray
        from ray.util.joblib import register_ray
    except ImportError as error:
        raise InputError(
            f"backend: ray is not installed here ({error}): `pip install '.[cluster]'` in a"
            " checkout of pneu, or 'FILE.whl[cluster]' for a wheel of it; or take backend loky"
        ) from None
    if not ray.is_initialized():
        try:
            ray.init(address=address, log_to_driver=False)
        except (ConnectionError, ValueError) as error:
            raise InputError(f"address: no Ray cluster at {address!r} ({error})") from None
    register_ray()


def _with(settings: Mapping[str, Any], path: list[str], value: Any, whole: str) -> dict[str, Any]:
    """Settings with one dotted field replaced."""
    out = dict(settings)
    if len(path) == 1:
        out[path[0]] = value
        return out
    below = out.get(path[0], {})
    if not isinstance(below, Mapping):
        raise InputError(f"sweep.{whole}: {path[0]} is no group of settings")
    out[path[0]] = _with(below, path[1:], value, whole)
    return out


def _word(value: Any) -> str:
    """A value as a part of a folder's name."""
    text = Path(value).stem if isinstance(value, str) else str(value)
    return re.sub(r"[^A-Za-z0-9.+-]+", "-", text).strip("-") or "none"
