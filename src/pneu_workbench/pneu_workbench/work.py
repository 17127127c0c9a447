# SPDX-License-Identifier: Apache-2.0
"""What is worked on, whatever pages look at it: recordings, versions of a model, one long task.

All of it is kept in a folder as it changes, so that it can be come back to; the task runs as a
process of its own and ends with the server, or when it is told to, not with a page.
"""

import json
import math
import re
import shlex
import shutil
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.report import write_report
from pneu_sysid.results.compare import CompareResult
from pneu_sysid.tasks.process import TaskProcess
from pneu_sysid.tasks.request import Outcome, Request
from pneu_sysid.tasks.signals import SIGNALS
from pneu_sysid.tasks.strength import with_strength
from pneu_workbench.live.link import Live
from pneu_workbench.packed import SESSION, pack
from pneu_workbench.store import Store
from pneu_workbench.trial import Trial, Trying
from pneu_workbench.versions import Version, Versions
from pneu_workbench.view import Seen, View

VERSION = 2
TRIED = "tried"
"""Folder of the signals of a strength that is tried."""


@dataclass
class Task:
    """Long work that goes on, or how it ended.

    Attributes:
        name: ``look``, ``suspect`` or ``add``.
        title: In words.
        stage: What it is at.
        done: Fraction done; None where it is not known.
        running: Whether it goes on.
        begun_s: When it began, by the monotonic clock, s.
        fault: Why it failed; empty where it did not.
        errors: Of each sensor, in noise units, as they fell.
        expected: How long it was expected to take, s, at least and at most; None where that is
            not known.
    """

    name: str
    title: str
    stage: str = "starting"
    done: float | None = None
    running: bool = True
    fault: str = ""
    begun_s: float = field(default_factory=time.monotonic)
    errors: list[dict[str, float]] = field(default_factory=list)
    expected: tuple[float, float] | None = None


class Work:
    """A session. Its methods may be called from any thread.

    Attributes:
        folder: Where it is kept.
        bags: The recordings.
        versions: Of the model.
        task: Long work, or the last that was.
        kept_aside: Parts that are kept aside for judging, s; every third stretch unless there is
            one.
        view: What there is to see.
        live: A running graph.
        source: Rig file that was opened; a copy of it is in the session.
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
        self.kept_aside: list[tuple[float, float]] = []
        self.source = ""
        self._seen = Seen()
        self._former: tuple[Versions, list[str]] | None = None
        self._trying: Trying | None = None
        self._workers = workers
        self._lock = threading.RLock()
        self._process: TaskProcess | None = None
        self._store = Store(self.folder)
        self.live = Live(self.folder, self._stir)
        self.view = View(self.folder, self._store, lambda: self.versions, self._seen)
        self._count = 0
        self._changes = 0
        if (self.folder / SESSION).exists():
            self._come_back()
            self._see()

    @property
    def changes(self) -> int:
        """A number that rises whenever anything has changed."""
        return self._changes

    @property
    def trial(self) -> Trial | None:
        """The present version at another strength; None where none is tried."""
        trying = self._trying
        return None if trying is None else trying.state

    # ---- long work --------------------------------------------------------------------------

    def open(self, bags: Sequence[str], rig: str, ask: bool = False) -> None:
        """Looks at recordings with a rig; all that was before is put away.

        Args:
            bags: Recordings of one rig.
            rig: Rig file.
            ask: Whether it is then asked what the model is missing.

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
            self.bags, self.source, self.kept_aside = list(bags), rig, []
            self.versions = Versions()
            self._seen.diagnosis = self._seen.beside = None
            self._store.forget()
            self._looked(folder, Path(rig).stem, 0)

        def early(at: str) -> None:
            with self._lock:
                if self.task is not None and self.task.running:
                    self._former = self.versions, self.bags
                    self.versions, self.bags = Versions(), list(bags)
                    self._seen.early = str(Path(at).relative_to(self.folder))
                    self._changed(keep=False)

        then = self.suspect if ask else None
        self._begin(request, f"looking at {Path(bags[0]).name}", opened, early, then)

    def keep_aside(self, parts: Sequence[tuple[float, float]]) -> None:
        """Keeps other parts of the recordings aside for judging; the present version stays.

        Args:
            parts: From and to, s; none is every third stretch again.

        Raises:
            InputError: Other work is going on, or nothing is open.
        """
        now = self._present()
        folder = self._fresh("look")
        request = replace(self._request("look", now.rig, folder), kept_aside=tuple(parts))

        def looked(outcome: Outcome) -> None:
            self.kept_aside = list(parts)
            # what was found was judged by other parts
            self._seen.diagnosis = None
            self._store.forget()
            self.versions.replace(self._version(folder, now.title, now.added))

        self._begin(request, "looking at what is kept aside", looked)

    def keep_rig(self, rig: Rig) -> Path:
        """Keeps a rig in the session; returns its file.

        Args:
            rig: The rig.
        """
        self._count += 1
        name = re.sub(r"[^A-Za-z0-9._-]", "_", rig.name).lstrip(".")[:60]
        path = self.folder / f"{name}_{self._count}.yaml"
        save_rig(rig, path)
        return path

    def edit(self, rig: Rig, words: str) -> None:
        """Makes a version of a rig that was edited by hand.

        Args:
            rig: The rig.
            words: What was changed.

        Raises:
            InputError: Other work is going on, or nothing is open.
        """
        was = self._present()
        if self.task is not None and self.task.running:
            raise InputError(f"{self.task.title}: is still going on; cancel it, or wait")
        folder = self._fresh("look")

        def looked(outcome: Outcome) -> None:
            self.versions.at = was.number
            self._looked(folder, words, was.added)

        self._begin(self._request("look", str(self.keep_rig(rig)), folder), words, looked)

    def suspect(self) -> None:
        """Asks what the present version is missing.

        Raises:
            InputError: Other work is going on, or nothing is open.
        """
        now = self._present()
        folder = self._fresh("suspect")

        def found(outcome: Outcome) -> None:
            told = json.loads((folder / "diagnose.json").read_text(encoding="utf-8"))
            self._seen.diagnosis = {"of": now.number, "folder": folder.name, "result": told}

        self._begin(self._request("suspect", now.rig, folder), "what is missing", found)

    def add(self, number: int) -> None:
        """Adds a candidate to the version that it was found for, and fits it.

        Args:
            number: Which of the candidates that were tried.

        Raises:
            InputError: Other work is going on, or there is no such candidate.
        """
        found, tried = self._seen.diagnosis, self.view.candidates()
        if found is None or not 0 <= number < len(tried):
            raise InputError(f"candidate: found {number}, there are {len(tried)} to add")
        chosen = tried[number]
        was = self.versions.all[found["of"]]
        folder = self._fresh("add")
        rig = self.folder / found["folder"] / f"candidate_{number}.yaml"
        added = was.added + 1
        label = f"{chosen.title} at {chosen.place}"

        def fitted(outcome: Outcome) -> None:
            self.versions.at = was.number
            self._looked(folder, f"with {label}", added)

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

        def changed() -> None:
            self._store.forget(TRIED)
            trial = self.trial
            self._seen.tried = TRIED if trial is not None and trial.errors else ""
            self._changes += 1

        with self._lock:
            folder = self.folder / TRIED
            self._trying = Trying(now, self.bags, self._workers, folder, changed)
            self._changes += 1

    def try_strength(self, strength: float) -> None:
        """Runs the present version at another strength; `trial` tells what came of it.

        Args:
            strength: How strong; beyond what may be it is cut off.

        Raises:
            InputError: No trial was begun, or it is not ready.
        """
        trying = self._trying
        if trying is None:
            raise InputError("strength: the model is not ready to be run at another")
        trying.run(strength)

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
        rig = self.folder / TRIED / "rig.yaml"
        save_rig(with_strength(load_rig(was.rig), trial.strength), rig)
        title = f"{trial.title} fixed at {trial.strength:.3g} {trial.unit}".strip()

        def looked(outcome: Outcome) -> None:
            self.versions.at = was.number
            self._looked(folder, title, was.added)

        self._begin(self._request("look", str(rig), folder), title, looked)

    def end_trial(self) -> None:
        """Tries no more strengths."""
        with self._lock:
            trying, self._trying = self._trying, None
            self._seen.tried = ""
            self._store.forget(TRIED)
            self._changes += 1
        if trying is not None:
            trying.end()

    def cancel(self) -> None:
        """Ends long work; nothing of it is kept."""
        with self._lock:
            process = self._process
        if process is not None:
            process.end()

    def close(self) -> None:
        """Ends what goes on, and waits until it is gone."""
        self.live.close()
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
            self._see()

    def redo(self) -> None:
        """Takes that back."""
        self.end_trial()
        with self._lock:
            self.versions.redo()
            self._changed()
            self._see()

    def go(self, number: int) -> None:
        """Looks at another version.

        Args:
            number: Which.
        """
        self.end_trial()
        with self._lock:
            self.versions.go(number)
            self._changed()
            self._see()

    def look_beside(self, number: int | None) -> None:
        """Draws another version beside the present one.

        Args:
            number: Which; None is the one that the present one came from.

        Raises:
            InputError: There is no such version.
        """
        if number is not None and not 0 <= number < len(self.versions.all):
            raise InputError(f"version: found {number}, there are {len(self.versions.all)}")
        with self._lock:
            self._seen.beside = number
            self._changed()

    # ---- to keep ----------------------------------------------------------------------------

    def rig_text(self) -> str:
        """The present version's rig file.

        Raises:
            InputError: Nothing is open.
        """
        return Path(self._present().rig).read_text(encoding="utf-8")

    def packed(self) -> Path:
        """Writes the session as one small file; returns its path.

        Raises:
            InputError: Nothing is open.
        """
        self._present()
        path = self.folder / "session.zip"
        with self._lock:
            pack(self.folder, path)
        return path

    def report(self) -> Path:
        """Writes the report of the present version; returns its path.

        Raises:
            InputError: Nothing is open.
        """
        now = self._present()
        path = self.folder / now.folder / "report.html"
        title = f"{now.title}: {', '.join(Path(bag).name for bag in self.bags)}"
        left, found = self.view.comparison(), self.view.found
        write_report(
            path,
            compare=None if left is None else left.as_dict(),
            diagnose=None if found is None else found.as_dict(),
            title=title,
        )
        return path

    def words(self) -> list[str]:
        """The commands that do the same."""
        now = self.versions.now
        if now is None:
            return []
        what = shlex.join([*self.bags, "--rig", self.source])
        aside = "".join(f" --aside {a:.6g}:{b:.6g}" for a, b in self.kept_aside)
        told = [f"pneu compare {what}", f"pneu diagnose {what}{aside}"]
        return [*told, f"pneu learn {what} -o learned"] if now.added else told

    def _see(self) -> None:
        """Runs the present version's model again where its signals were left out of a file."""
        now = self.versions.now
        if now is None or (self.folder / now.folder / SIGNALS).exists():
            return
        if self.task is not None and self.task.running:
            return
        folder = self._fresh("look")

        def looked(outcome: Outcome) -> None:
            self.versions.all[now.number] = replace(now, folder=folder.name)

        self._begin(self._request("look", now.rig, folder), f"running {now.title}", looked)

    # ---- within -----------------------------------------------------------------------------

    def _present(self) -> Version:
        now = self.versions.now
        if now is None:
            raise InputError("recording: nothing is open yet")
        return now

    def _request(self, task: str, rig: str, folder: Path, added: int = 1) -> Request:
        bag, *more = self.bags
        return Request(
            task, bag, rig, str(folder), f"{folder}.part", self._workers, tuple(more), added,
            tuple(self.kept_aside),
        )  # fmt: skip

    def _fresh(self, name: str) -> Path:
        self._count += 1
        return self.folder / f"{name}_{self._count}_{uuid.uuid4().hex[:6]}"

    def _begin(
        self,
        request: Request,
        title: str,
        then: Callable[[Outcome], None],
        early: Callable[[str], None] | None = None,
        after: Callable[[], None] | None = None,
    ) -> None:
        if request.task != "suspect":  # which leaves the version as it is
            self.end_trial()
        with self._lock:
            if self.task is not None and self.task.running:
                raise InputError(f"{self.task.title}: is still going on; cancel it, or wait")
            expected = self.view.expected(request.task)
            task = self.task = Task(request.task, title, expected=expected)
            self._changed(keep=False)

            def tell(stage: str, done: float) -> None:
                task.stage, task.done = stage, None if math.isnan(done) else done
                self._changes += 1

            def errors(told: dict[str, float]) -> None:
                task.errors.append(told)
                self._changes += 1

            def ended(outcome: Outcome) -> None:
                with self._lock:
                    self._process, self._seen.early = None, ""
                    former, self._former = self._former, None
                    if former is not None and not outcome.success:  # what was open before
                        self.versions, self.bags = former
                    if outcome.success:
                        try:
                            then(outcome)
                        except (OSError, ValueError, KeyError) as error:
                            outcome = Outcome(False, str(error))
                    task.fault = "" if outcome.success else outcome.message
                    task.running = False
                    self._changed()
                    if after is not None and outcome.success:
                        after()

            self._process = TaskProcess(request, tell, ended, errors, early)

    def _looked(self, folder: Path, title: str, added: int) -> None:
        """Makes a version of what was looked at."""
        self.versions.add(self._version(folder, title, added))

    def _version(self, folder: Path, title: str, added: int) -> Version:
        text = (folder / "compare.json").read_text(encoding="utf-8")
        model = CompareResult(**json.loads(text)).models[0]
        return Version(
            number=0,
            parent=None,
            title=title,
            folder=folder.name,
            rig=str(folder / "rig.yaml"),
            added=added,
            times_noise={name: one.times_noise for name, one in model.sensors.items()},
            overall=model.times_noise,
        )

    def _stir(self) -> None:
        self._changes += 1

    def _changed(self, keep: bool = True) -> None:
        self._changes += 1
        if keep:
            state = {
                "pneu_workbench": VERSION,
                "bags": self.bags,
                "source": self.source,
                "versions": asdict(self.versions),
                "diagnosis": self._seen.diagnosis,
                "beside": self._seen.beside,
                "kept_aside": self.kept_aside,
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
            self.bags, self._seen.diagnosis = state["bags"], state["diagnosis"]
            self._seen.beside = state["beside"]
            self.kept_aside = [(float(a), float(b)) for a, b in state["kept_aside"]]
            self.source = state["source"]
            self._count = state["count"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: is no session of the workbench ({error})") from None
        for left in self.folder.glob("*.part"):  # of a task that ended with the machine
            shutil.rmtree(left, ignore_errors=True)
