# SPDX-License-Identifier: Apache-2.0
"""A training run: iterations of roll-out and update, history, checkpoints and the exported policy.

All random draws of an iteration are made by generators seeded with the run's seed and the number of
the iteration. What a checkpoint must hold is then networks, optimiser and history, and a run that
is taken up again does bit for bit what it would have done uninterrupted.
"""

import contextlib
import hashlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.process import TerminatedError
from pneu_policy.learn import npg
from pneu_policy.learn.checkpoint import load_checkpoint, save_checkpoint
from pneu_policy.learn.export import Trained, export_policy
from pneu_policy.learn.history import History, Row
from pneu_policy.learn.networks import GaussianPolicy, ValueNetwork, mean_action
from pneu_policy.learn.rollout import Episodes, roll_out
from pneu_policy.learn.settings import TrainSettings
from pneu_policy.task.make import make_env
from pneu_policy.task.task_env import TaskEnv

Array = NDArray[np.float32]

CHECKPOINT = "checkpoint.pt"
HISTORY = "history.json"
POLICY = "policy.npz"

_FIRST_WEIGHTS, _EPISODES, _EXPLORATION, _VALUE_ORDER = range(4)


def generator(seed: int, purpose: int, iteration: int) -> np.random.Generator:
    """The generator of one purpose in one iteration.

    Args:
        seed: Seed of the run.
        purpose: A number per purpose, so that they do not share numbers.
        iteration: Which iteration.
    """
    return np.random.default_rng([seed, purpose, iteration])


class Trainer:
    """Trains a policy by the natural policy gradient.

    Attributes:
        settings: What it is set to.
        env: The environment.
        policy: The policy, at its latest iterate.
        values: The value function.
        average: Average of the iterates as one vector, where the settings ask for one.
        rows: History so far, one row per iteration done.
        file_sha256: Digest of the rig or hand file.
    """

    def __init__(self, settings: TrainSettings, env: TaskEnv | None = None) -> None:
        """Makes networks at random and the environment.

        Args:
            settings: What it is set to.
            env: Environment in place of the one in the settings; its episodes end together, and
                ``reset(seed=...)`` decides them.

        Raises:
            InputError: The device is not there, or the environment refuses its settings.
        """
        if settings.device.startswith("cuda") and not torch.cuda.is_available():
            raise InputError(f"device: found {settings.device!r}, but PyTorch sees no GPU here")
        torch.set_num_threads(settings.threads)
        self.settings = settings
        self.env = make_env(settings.env) if env is None else env
        # Of the file as it is now: it may be changed while the training goes on.
        rig = Path(settings.env.file)
        self.file_sha256 = hashlib.sha256(rig.read_bytes()).hexdigest() if rig.exists() else ""
        n = settings.npg
        inputs = int(self.env.single_observation_space.shape[0])
        actions = int(self.env.single_action_space.shape[0])
        rng = generator(settings.seed, _FIRST_WEIGHTS, 0)
        self.policy = GaussianPolicy(
            inputs, actions, n.hidden, n.log_std_init, n.log_std_floor, rng
        ).to(settings.device)
        self.values = ValueNetwork(inputs, n.value_hidden, rng).to(settings.device)
        self._optimiser = torch.optim.Adam(
            self.values.parameters(), n.value_learning_rate, fused=True
        )
        self.average = self.policy.flat()
        self.rows: list[Row] = []

    @property
    def done(self) -> int:
        """Iterations done."""
        return len(self.rows)

    @property
    def finished(self) -> bool:
        """Whether all iterations are done."""
        return self.done >= self.settings.iterations

    def iterate(self) -> Row:
        """One iteration: episodes, update, and an evaluation where it is due.

        Returns:
            The row of the history.

        Raises:
            FloatingPointError: The environment or the policy left the finite numbers.
        """
        started, busy = time.perf_counter(), time.process_time()
        s, k = self.settings, self.done
        rng = generator(s.seed, _EXPLORATION, k)
        weights = self.policy.weights()
        std = self.policy.log_std.detach().exp().cpu().numpy()

        def explore(observations: Array) -> Array:
            mean = mean_action(weights, observations)
            noise = rng.standard_normal(mean.shape, dtype=np.float32)
            return np.asarray(mean + std * noise, np.float32)

        seed = int(generator(s.seed, _EPISODES, k).integers(2**31))
        episodes = roll_out(self.env, explore, seed)
        batch = npg.Batch(
            episodes.observations,
            episodes.actions,
            episodes.rewards,
            episodes.alive,
            episodes.ended,
        )
        order = generator(s.seed, _VALUE_ORDER, k)
        update = npg.update(self.policy, self.values, self._optimiser, batch, s.npg, order)
        latest = self.policy.flat()
        if not bool(torch.isfinite(latest).all()):
            raise FloatingPointError(f"the policy is not finite after iteration {k + 1}")
        self.average = s.average_decay * self.average + (1.0 - s.average_decay) * latest

        last = k + 1 == s.iterations
        judged = self.evaluate() if last or (k + 1) % s.evaluate_every == 0 or k == 0 else None
        before = self.rows[-1] if self.rows else None
        samples = episodes.samples + (before["samples"] if before else 0)
        row = {
            "iteration": k + 1,
            "samples": samples,
            "simulated_s": samples * self.env.period_s,
            "wall_s": time.perf_counter() - started + (before["wall_s"] if before else 0.0),
            "cpu_s": time.process_time() - busy + (before.get("cpu_s", 0.0) if before else 0.0),
            "score": episodes.score,
            "rmse": episodes.rmse,
            "eval_score": judged.score if judged else None,
            "eval_rmse": judged.rmse if judged else None,
            "eval_success": judged.successful if judged else None,
            "std": float(std.mean()),
            "kl": update.kl,
            "step": update.step,
            "explained": update.explained,
        }
        self.rows.append(row)
        return row

    def weights(self) -> list[tuple[Array, Array]]:
        """The mean network that is evaluated and exported: the latest iterate or the average."""
        if self.settings.average_decay == 0.0:
            return self.policy.weights()
        latest = self.policy.flat()
        self.policy.set_flat(self.average)
        weights = self.policy.weights()
        self.policy.set_flat(latest)
        return weights

    def evaluate(self) -> Episodes:
        """Episodes without exploration, always the same ones.

        Returns:
            The episodes.
        """
        weights = self.weights()
        seed = self.settings.evaluation_seed
        return roll_out(self.env, lambda seen: mean_action(weights, seen), seed)

    def history(self) -> History:
        """How the training went so far."""
        return History(
            "npg",
            self.settings.plain(),
            list(self.rows),
            self.finished,
            self.env.unit[0],
            self.env.mark,
        )

    def save(self, path: str | Path) -> None:
        """Writes a checkpoint.

        Args:
            path: The file; its folder must exist.

        Raises:
            InputError: It cannot be written.
        """
        state = {
            "settings": self.settings.plain(),
            "file_sha256": self.file_sha256,
            "policy": self.policy.state_dict(),
            "values": self.values.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "average": self.average,
            "rows": self.rows,
        }
        save_checkpoint(state, path)

    def resume(self, path: str | Path) -> None:
        """Goes on from a checkpoint of the same settings; only more iterations may be asked for.

        Args:
            path: The file.

        Raises:
            InputError: It cannot be read, or is of other settings; the message names the first.
        """
        state = load_checkpoint(path)
        try:
            other = first_difference(state["settings"], self.settings.plain(), ("iterations",))
            if other:
                raise InputError(f"{path}: the checkpoint is of other settings: {other}")
            if state["file_sha256"] != self.file_sha256:
                raise InputError(
                    f"{path}: the checkpoint is of {self.settings.env.file} as it was"
                    " before it was changed; start anew"
                )
            self.policy.load_state_dict(state["policy"])
            self.values.load_state_dict(state["values"])
            self._optimiser.load_state_dict(state["optimiser"])
            self.average = state["average"].to(self.settings.device)
            self.rows = list(state["rows"])
        except (KeyError, RuntimeError) as error:
            raise InputError(f"{path}: the checkpoint lacks a part ({error})") from None

    def run(self, folder: str | Path, report: Callable[[Row], None] | None = None) -> History:
        """Does what is left to do; writes checkpoints, history and the policy into a folder.

        The first SIGINT or SIGTERM lets the present iteration end, writes a checkpoint and stops.

        Args:
            folder: Where; it must exist.
            report: Called with each row.

        Returns:
            The history.

        Raises:
            KeyboardInterrupt: After a clean end by a signal.
        """
        folder = Path(folder)
        with _held_back() as signals:
            while not self.finished and not signals:
                row = self.iterate()
                if report:
                    report(row)
                if self.done % self.settings.checkpoint_every == 0:
                    self._write(folder)
                every = self.settings.keep_every
                if every and self.done % every == 0:
                    self._export(folder / f"policy_{self.done:04d}.npz")
            self._write(folder)
            if not self.finished:
                raise TerminatedError if signal.SIGTERM in signals else KeyboardInterrupt
        self._export(folder / POLICY)
        return self.history()

    def _export(self, path: Path) -> None:
        """Writes the policy as it now is."""
        trained = Trained(
            self.env,
            self.settings,
            self.rows[-1],
            self.done,
            self.file_sha256,
            self.weights(),
            float(self.policy.log_std.detach().cpu()[0]),
        )
        export_policy(trained, path)

    def _write(self, folder: Path) -> None:
        self.save(folder / CHECKPOINT)
        self.history().save(folder / HISTORY)


def first_difference(found: Any, wanted: Any, but: tuple[str, ...] = ()) -> str | None:
    """The first setting in which two differ, in words.

    Args:
        found: Settings as plain values.
        wanted: Others.
        but: Settings at the top that may differ.

    Returns:
        One clause, or None where they agree.
    """
    if isinstance(found, dict) and isinstance(wanted, dict):
        for name in (*found, *wanted):
            if name in but:
                continue
            below = first_difference(found.get(name), wanted.get(name))
            if below:
                return f"{name}.{below}" if not below.startswith(":") else f"{name}{below}"
        return None
    return None if found == wanted else f": found {found!r}, wanted {wanted!r}"


@contextlib.contextmanager
def _held_back() -> Iterator[list[int]]:
    """Collects first signals, because an update cut in two leaves no state to go on from."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received  # signals reach the main thread only
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def note(number: int, frame: Any) -> None:
        received.append(number)
        signal.signal(number, before[signal.Signals(number)])  # a second takes effect at once

    for number in before:
        signal.signal(number, note)
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
