# SPDX-License-Identifier: Apache-2.0
"""What is worked on, whatever pages look at it: recordings, versions of a model, one long task.

All of it is kept in a folder as it changes, so that it can be come back to; the task runs as a
process of its own and ends with the server, or when it is told to, not with a page.
"""

import json
import math
import shutil
import threading
import uuid
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.report import write_report
from pneu_sysid.tasks.process import TaskProcess
from pneu_sysid.tasks.request import Outcome, Request
from pneu_sysid.tasks.signals import Signals, load_signals
from pneu_sysid.tasks.trial import with_strength
from pneu_sysid.tasks.trial_process import TrialProcess
from pneu_workbench.traces import Pyramid
from pneu_workbench.versions import Version, Versions

SESSION = "session.json"
VERSION = 1
TRIED = "tried"
"""Folder of the signals of a strength that is tried."""
KEPT = 4
"""Models whose signals are held in memory."""

Kind = Literal["measured", "model", "before", "trial", "residual", "candidate", "command"]


@dataclass
class Task:
    """Long work that goes on, or how it ended.

    Attributes:
        name: ``look``, ``suspect`` or ``add``.
        title: In words.
        stage: What it is at.
        done: Fraction done; None where it is not known.
        running: Whether it goes on.
        fault: Why it failed; empty where it did not.
        errors: Of each sensor, in noise units, as they fell.
    """

    name: str
    title: str
    stage: str = "starting"
    done: float | None = None
    running: bool = True
    fault: str = ""
    errors: list[dict[str, float]] = field(default_factory=list)


@dataclass
class Trial:
    """The present version run with another strength of what was added last.

    Attributes:
        of: Number of the version.
        strength: How strong it was tried; None is not yet.
        lower: Least strength that may be.
        upper: Most.
        unit: Of all three.
        title: What was added.
        errors: Of each sensor over its noise, at that strength.
        ready: Whether the model is ready to be run.
        fault: Why not; empty where it is.
    """

    of: int
    strength: float | None = None
    lower: float = 0.0
    upper: float = 0.0
    unit: str = ""
    title: str = ""
    errors: dict[str, float] = field(default_factory=dict)
    ready: bool = False
    fault: str = ""


class Work:
    """A session. Its methods may be called from any thread.

    Attributes:
        folder: Where it is kept.
        bags: The recordings.
        versions: Of the model.
        task: Long work, or the last that was.
        diagnosis: What was found missing in the version of that number.
        trial: The present version at another strength; None where none is tried.
    """

    def __init__(self, folder: Path, workers: int = 0) -> None:
        """Begins one, or comes back to one.

        Args:
            folder: Where it is kept; made where it is not there.
            workers: Threads of a task; 0 is all cores.

        Raises:
            InputError: The folder cannot be made, or holds what is no session.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made a folder ({error.strerror})") from None
        self.folder = folder.resolve()
        self.bags: list[str] = []
        self.versions = Versions()
        self.task: Task | None = None
        self.diagnosis: dict[str, Any] | None = None
        self.trial: Trial | None = None
        self._trying: TrialProcess | None = None
        self._workers = workers
        self._lock = threading.RLock()
        self._process: TaskProcess | None = None
        self._loaded: dict[str, tuple[Signals, dict[tuple[str, str], Pyramid]]] = {}
        self._count = 0
        self._changes = 0
        if (self.folder / SESSION).exists():
            self._come_back()

    @property
    def changes(self) -> int:
        """A number that rises whenever anything has changed."""
        return self._changes

    # ---- long work --------------------------------------------------------------------------

    def open(self, bags: Sequence[str], rig: str) -> None:
        """Looks at recordings with a rig; all that was before is put away.

        Args:
            bags: Recordings of one rig.
            rig: Rig file.

        Raises:
            InputError: Other work is going on, or a file is not there.
        """
        if not bags:
            raise InputError("recording: none was chosen, one is needed at least")
        folder = self._fresh("look")
        request = Request(
            "look", bags[0], rig, str(folder), f"{folder}.part", self._workers, tuple(bags[1:])
        )

        def opened(outcome: Outcome) -> None:
            self.bags, self.versions, self.diagnosis = list(bags), Versions(), None
            self._loaded.clear()
            self._looked(folder, Path(rig).stem, rig, 0)

        self._begin(request, f"looking at {Path(bags[0]).name}", opened)

    def suspect(self) -> None:
        """Asks what the present version is missing.

        Raises:
            InputError: Other work is going on, or nothing is open.
        """
        now = self._present()
        folder = self._fresh("suspect")

        def found(outcome: Outcome) -> None:
            told = json.loads((folder / "diagnose.json").read_text(encoding="utf-8"))
            self.diagnosis = {"of": now.number, "folder": folder.name, "result": told}

        self._begin(self._request("suspect", now.rig, folder), "what is missing", found)

    def add(self, number: int) -> None:
        """Adds a candidate to the version that it was found for, and fits it.

        Args:
            number: Which of the candidates that were tried.

        Raises:
            InputError: Other work is going on, or there is no such candidate.
        """
        found, tried = self.diagnosis, self.candidates()
        if found is None or not 0 <= number < len(tried):
            raise InputError(f"candidate: found {number}, there are {len(tried)} to add")
        chosen = tried[number]
        was = self.versions.all[found["of"]]
        folder = self._fresh("add")
        rig = self.folder / found["folder"] / f"candidate_{number}.yaml"
        added = was.added + 1
        label = f"{chosen['title']} at {chosen['place']}"

        def fitted(outcome: Outcome) -> None:
            self.versions.at = was.number
            self._looked(folder, f"with {label}", str(folder / "rig.yaml"), added)

        self._begin(self._request("add", str(rig), folder, added), f"adding {label}", fitted)

    def begin_trial(self) -> None:
        """Makes the present version ready to be run at other strengths of what was added last.

        Raises:
            InputError: Nothing was added.
        """
        now = self._present()
        if not now.added:
            raise InputError("strength: nothing was added yet whose strength could be tried")
        self.end_trial()
        with self._lock:
            trial = self.trial = Trial(now.number)
            self._changes += 1

            def heard(told: dict[str, Any]) -> None:
                with self._lock:
                    if "fault" in told:
                        trial.fault, trial.ready = told["fault"], False
                    elif "errors" in told:
                        trial.strength, trial.errors = told["strength"], told["errors"]
                        self._loaded.pop(TRIED, None)
                    else:
                        trial.lower, trial.upper = told["lower"], told["upper"]
                        trial.unit, trial.title = told["unit"] or "", told["title"]
                        trial.strength, trial.ready = told["strength"], True
                    self._changes += 1

            self._trying = TrialProcess(self.bags, now.rig, self._workers, heard)

    def try_strength(self, strength: float) -> None:
        """Runs the present version at another strength; `trial` tells what came of it.

        Args:
            strength: How strong; beyond what may be it is cut off.

        Raises:
            InputError: No trial was begun, or it is not ready.
        """
        trial, process = self.trial, self._trying
        if trial is None or process is None or not trial.ready:
            raise InputError("strength: the model is not ready to be run at another")
        folder = self.folder / TRIED
        folder.mkdir(exist_ok=True)
        strength = min(max(strength, trial.lower), trial.upper)
        process.run(strength, str(folder / "signals.npz"))

    def keep_trial(self) -> None:
        """Makes a version of the strength that was tried.

        Raises:
            InputError: None was tried, or other work is going on.
        """
        trial = self.trial
        if trial is None or trial.strength is None or not trial.errors:
            raise InputError("strength: none was tried that could be kept")
        was = self.versions.all[trial.of]
        folder = self._fresh("look")
        rig = self.folder / f"{folder.name}.yaml"  # its folder is not there yet
        save_rig(with_strength(load_rig(was.rig), trial.strength), rig)
        title = f"{trial.title} fixed at {trial.strength:.3g} {trial.unit}".strip()

        def looked(outcome: Outcome) -> None:
            self.versions.at = was.number
            self._looked(folder, title, str(rig), was.added)

        self._begin(self._request("look", str(rig), folder), title, looked)

    def end_trial(self) -> None:
        """Tries no more strengths."""
        with self._lock:
            process, self._trying, self.trial = self._trying, None, None
            self._loaded.pop(TRIED, None)
            self._changes += 1
        if process is not None:
            process.end()

    def cancel(self) -> None:
        """Ends long work; nothing of it is kept."""
        with self._lock:
            process = self._process
        if process is not None:
            process.end()

    def close(self) -> None:
        """Ends what goes on, and waits until it is gone."""
        self.end_trial()
        with self._lock:
            process = self._process
        if process is not None:
            process.end()
            process.wait()

    # ---- versions ---------------------------------------------------------------------------

    def undo(self) -> None:
        """Goes back to where the present version came from."""
        self.end_trial()
        with self._lock:
            self.versions.undo()
            self._changed()

    def redo(self) -> None:
        """Takes that back."""
        self.end_trial()
        with self._lock:
            self.versions.redo()
            self._changed()

    def go(self, number: int) -> None:
        """Looks at another version.

        Args:
            number: Which.
        """
        self.end_trial()
        with self._lock:
            self.versions.go(number)
            self._changed()

    # ---- what there is to see ---------------------------------------------------------------

    def comparison(self) -> dict[str, Any] | None:
        """What the present version leaves, as `pneu compare --json` has it; None without one."""
        now = self.versions.now
        if now is None:
            return None
        path = self.folder / now.folder / "compare.json"
        return dict(json.loads(path.read_text(encoding="utf-8")))

    def visited(self) -> dict[str, Any] | None:
        """Where the recordings have been, and what is kept aside of them; None without any."""
        now = self.versions.now
        if now is None:
            return None
        path = self.folder / now.folder / "visited.json"
        return dict(json.loads(path.read_text(encoding="utf-8")))

    def rig(self) -> Rig | None:
        """The present version's rig; None without one, or where its file is gone."""
        now = self.versions.now
        try:
            return None if now is None else load_rig(now.rig)
        except InputError:
            return None

    def candidates(self) -> list[dict[str, Any]]:
        """Candidates that were tried, best first, of the diagnosis of the present version."""
        found, now = self.diagnosis, self.versions.now
        if found is None or now is None or found["of"] != now.number:
            return []
        return [one for one in found["result"]["candidates"] if one["tested"]]

    def sensors(self) -> list[tuple[str, str, float]]:
        """Sensors with their units and noise floors, SI."""
        signals = self._signals()
        if signals is None:
            return []
        about = signals[0].about
        return [(name, about.units[name], about.noise[name]) for name in signals[0].sensors]

    def commands(self) -> list[str]:
        """Names of commands."""
        signals = self._signals()
        return [] if signals is None else list(signals[0].commands)

    def span_s(self) -> tuple[float, float]:
        """First and last time of all readings, s."""
        signals = self._signals()
        if signals is None:
            return 0.0, 0.0
        times = [t.time_s for t in signals[0].sensors.values() if t.time_s.size]
        return min(float(t[0]) for t in times), max(float(t[-1]) for t in times)

    def pyramid(self, kind: Kind, name: str, candidate: int | None = None) -> Pyramid:
        """A signal, to be shown at any zoom.

        Args:
            kind: Which of a sensor's signals, or a command.
            name: Of the sensor or the command.
            candidate: Whose predicted residual is meant.

        Raises:
            KeyError: There is no such signal.
        """
        held = self._signals()
        if held is None:
            raise KeyError(name)
        signals, known = held
        if kind == "trial":
            if self.trial is None or not self.trial.errors:
                raise KeyError(name)
            tried, its = self._load(TRIED)
            at = tried.sensors[name]
            return self._once(its, ("model", name), lambda: Pyramid(at.time_s, at.model))
        if kind == "before":
            before = self.versions.before
            if before is None:
                raise KeyError(name)
            former, own = self._load(before.folder)
            was = former.sensors[name]
            return self._once(own, ("model", name), lambda: Pyramid(was.time_s, was.model))
        if kind == "command":
            return self._once(known, ("command", name), lambda: _held(signals, name))
        trace = signals.sensors[name]
        if kind == "candidate":
            found, now = self.diagnosis, self.versions.now
            if found is None or now is None or found["of"] != now.number:
                raise KeyError(name)
            other = self._load(found["folder"])
            key = f"candidate_{candidate}"
            told = other[0].sensors[name]
            noise = signals.about.noise[name]
            change = told.changes[key]
            return self._once(other[1], (key, name), lambda: Pyramid(told.time_s, change / noise))
        values = {
            "measured": lambda: trace.measured,
            "model": lambda: trace.model,
            "residual": lambda: (trace.measured - trace.model) / signals.about.noise[name],
        }[kind]
        return self._once(known, (kind, name), lambda: Pyramid(trace.time_s, values()))

    # ---- to keep ----------------------------------------------------------------------------

    def rig_text(self) -> str:
        """The present version's rig file.

        Raises:
            InputError: Nothing is open.
        """
        return Path(self._present().rig).read_text(encoding="utf-8")

    def report(self) -> Path:
        """Writes the report of the present version; returns its path.

        Raises:
            InputError: Nothing is open.
        """
        now = self._present()
        path = self.folder / now.folder / "report.html"
        found = self.diagnosis
        own = found["result"] if found is not None and found["of"] == now.number else None
        title = f"{now.title}: {', '.join(Path(bag).name for bag in self.bags)}"
        write_report(path, compare=self.comparison(), diagnose=own, title=title)
        return path

    def words(self) -> list[str]:
        """The commands that do the same."""
        now = self.versions.now
        if now is None:
            return []
        bags, rig = " ".join(self.bags), self.versions.all[0].rig
        told = [f"pneu compare {bags} --rig {rig}", f"pneu diagnose {bags} --rig {rig}"]
        return [*told, f"pneu learn {bags} --rig {rig} -o learned"] if now.added else told

    # ---- within -----------------------------------------------------------------------------

    def _present(self) -> Version:
        now = self.versions.now
        if now is None:
            raise InputError("recording: nothing is open yet")
        return now

    def _request(self, task: str, rig: str, folder: Path, added: int = 1) -> Request:
        bag, *more = self.bags
        return Request(
            task, bag, rig, str(folder), f"{folder}.part", self._workers, tuple(more), added
        )

    def _fresh(self, name: str) -> Path:
        self._count += 1
        return self.folder / f"{name}_{self._count}_{uuid.uuid4().hex[:6]}"

    def _begin(self, request: Request, title: str, then: Callable[[Outcome], None]) -> None:
        if request.task != "suspect":  # which leaves the version as it is
            self.end_trial()
        with self._lock:
            if self.task is not None and self.task.running:
                raise InputError(f"{self.task.title}: is still going on; cancel it, or wait")
            task = self.task = Task(request.task, title)
            self._changed(keep=False)

            def tell(stage: str, done: float) -> None:
                task.stage, task.done = stage, None if math.isnan(done) else done
                self._changes += 1

            def errors(told: dict[str, float]) -> None:
                task.errors.append(told)
                self._changes += 1

            def ended(outcome: Outcome) -> None:
                with self._lock:
                    self._process = None
                    if outcome.success:
                        try:
                            then(outcome)
                        except (OSError, ValueError, KeyError) as error:
                            outcome = Outcome(False, str(error))
                    task.fault = "" if outcome.success else outcome.message
                    task.running = False
                    self._changed()

            self._process = TaskProcess(request, tell, ended, errors)

    def _looked(self, folder: Path, title: str, rig: str, added: int) -> None:
        """Makes a version of what was looked at."""
        told = json.loads((folder / "compare.json").read_text(encoding="utf-8"))["models"][0]
        each = {**told["taps"], **told.get("encoders", {})}
        self.versions.add(
            Version(
                number=0,
                parent=None,
                title=title,
                folder=folder.name,
                rig=rig,
                added=added,
                times_noise={name: one["times_noise"] for name, one in each.items()},
                overall=told["times_noise"],
            )
        )

    def _signals(self) -> tuple[Signals, dict[tuple[str, str], Pyramid]] | None:
        now = self.versions.now
        return None if now is None else self._load(now.folder)

    def _load(self, folder: str) -> tuple[Signals, dict[tuple[str, str], Pyramid]]:
        with self._lock:
            if folder not in self._loaded:
                while len(self._loaded) >= KEPT:
                    del self._loaded[next(iter(self._loaded))]
                self._loaded[folder] = (load_signals(self.folder / folder / "signals.npz"), {})
            return self._loaded[folder]

    def _once(
        self,
        known: dict[tuple[str, str], Pyramid],
        key: tuple[str, str],
        make: Callable[[], Pyramid],
    ) -> Pyramid:
        with self._lock:
            if key not in known:
                known[key] = make()
            return known[key]

    def _changed(self, keep: bool = True) -> None:
        self._changes += 1
        if keep:
            state = {
                "pneu_workbench": VERSION,
                "bags": self.bags,
                "versions": asdict(self.versions),
                "diagnosis": self.diagnosis,
                "count": self._count,
            }
            write_whole(self.folder / SESSION, json.dumps(state))

    def _come_back(self) -> None:
        path = self.folder / SESSION
        try:
            state = json.loads(path.read_text(encoding="utf-8"))
            if state["pneu_workbench"] != VERSION:
                raise ValueError(f"version {state['pneu_workbench']!r}")
            of = state["versions"]
            self.versions = Versions([Version(**v) for v in of["all"]], of["at"], of["undone"])
            self.bags, self.diagnosis = state["bags"], state["diagnosis"]
            self._count = state["count"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: is no session of the workbench ({error})") from None
        for left in self.folder.glob("*.part"):  # of a task that ended with the machine
            shutil.rmtree(left, ignore_errors=True)


def _held(signals: Signals, name: str) -> Pyramid:
    """A command as steps: held until it changes, to the end of all readings."""
    time, volts = signals.commands[name]
    end = max(t.time_s[-1] for t in signals.sensors.values() if t.time_s.size)
    steps = [x for pair in zip(time, [*time[1:], max(end, time[-1])], strict=True) for x in pair]
    return Pyramid(steps, [v for one in volts for v in (one, one)])  # type: ignore[arg-type]
