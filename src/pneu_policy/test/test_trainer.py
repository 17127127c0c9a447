# SPDX-License-Identifier: Apache-2.0
"""Training runs on a real rig: exact resumption, files, sweeps, and what is said of bad input."""

import importlib.util
import json
import signal
import tempfile
from pathlib import Path

import numpy as np
import pytest
import typer
from matplotlib.image import imread
from typer.testing import CliRunner

torch = pytest.importorskip("torch")

from pneu_common.errors import InputError  # noqa: E402
from pneu_policy.control.policy_file import PolicyFile  # noqa: E402
from pneu_policy.learn import sweep  # noqa: E402
from pneu_policy.learn.checkpoint import load_checkpoint, save_checkpoint  # noqa: E402
from pneu_policy.learn.command import register_train  # noqa: E402
from pneu_policy.learn.curves import learning_curves  # noqa: E402
from pneu_policy.learn.history import History  # noqa: E402
from pneu_policy.learn.networks import mean_action  # noqa: E402
from pneu_policy.learn.rollout import roll_out  # noqa: E402
from pneu_policy.learn.settings import TrainSettings, load_settings  # noqa: E402
from pneu_policy.learn.trainer import Trainer  # noqa: E402
from pneu_policy.task.make import make_env  # noqa: E402

ROOT = Path(__file__).parents[3]

# The lumped model, because it is the fastest; the training does not know which one it trains on.
PLAIN = {
    "env": {
        "rig": str(ROOT / "rigs/rig_a_thin_plate.yaml"),
        "recipe": {"tap": "end", "taps": ["end"]},
        "num_envs": 4,
        "horizon": 30,
    },
    "npg": {"value_steps": 20, "hidden": [8], "value_hidden": [16]},
    "iterations": 4,
    "evaluate_every": 2,
    "checkpoint_every": 1,
    "seed": 3,
}


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def env():
    return make_env(settings().env)


def settings(**changes):
    return TrainSettings(**{**PLAIN, **changes})


def untimed(rows):
    return [
        {key: value for key, value in row.items() if key not in ("wall_s", "cpu_s")} for row in rows
    ]


@pytest.mark.long
def test_a_resumed_run_is_bit_for_bit_the_uninterrupted_one(tmp_path, env):
    whole = Trainer(settings(average_decay=0.5), env)
    first = Trainer(settings(average_decay=0.5), env)
    for _ in range(4):
        whole.iterate()
    for _ in range(2):
        first.iterate()
    first.save(tmp_path / "checkpoint.pt")
    second = Trainer(settings(average_decay=0.5), env)
    second.resume(tmp_path / "checkpoint.pt")
    assert second.done == 2
    for _ in range(2):
        second.iterate()
    assert torch.equal(second.policy.flat(), whole.policy.flat())
    assert torch.equal(second.average, whole.average)
    for one, other in zip(second.values.parameters(), whole.values.parameters(), strict=True):
        assert torch.equal(one, other)
    assert untimed(second.rows) == untimed(whole.rows)
    assert not torch.equal(whole.policy.flat(), first.policy.flat())


def test_seeds_decide_the_run(env):
    runs = {}
    for name, seed in (("one", 0), ("same", 0), ("other", 1)):
        trainer = Trainer(settings(seed=seed), env)
        trainer.iterate()
        runs[name] = trainer.policy.flat()
    assert torch.equal(runs["one"], runs["same"])
    assert not torch.equal(runs["one"], runs["other"])


def test_rows_tell_what_the_episodes_were(env):
    trainer = Trainer(settings(), env)
    episodes = trainer.evaluate()
    row = trainer.iterate()
    assert row["samples"] == 4 * 30 and row["simulated_s"] == pytest.approx(1.2)
    after = trainer.evaluate()
    assert row["eval_score"] == after.score and row["eval_rmse"] == after.rmse
    assert after.score != episodes.score
    # from the environment itself, without the code of the roll-outs
    seen, _ = env.reset(seed=trainer.settings.evaluation_seed)
    errors, rewards = [], []
    for _ in range(30):
        action = trainer.policy(torch.from_numpy(seen)).detach().numpy()
        seen, reward, _, _, info = env.step(action)
        errors.append(info["error"].copy())
        rewards.append(reward.copy())
    assert after.rmse == pytest.approx(np.sqrt(np.mean(np.square(errors))) / 101325, rel=1e-4)
    assert after.score == pytest.approx(np.sum(rewards) / 4, rel=1e-4)


def test_arms_that_push_are_trained_and_kept_too(tmp_path):
    from pneu_policy.control.push_policy import PushPolicy

    push = {
        "task": "push",
        "hand": str(ROOT / "scenes/phantom/pushing.yaml"),
        "num_envs": 2,
        "horizon": 5,
        "threads": 1,
    }
    history = Trainer(settings(env=push, iterations=2, evaluate_every=1)).run(tmp_path)
    assert history.unit == "mm" and history.mark == 5.0
    assert 0.0 < history.rows[-1]["eval_rmse"] < 10.0  # it lies where the path begins
    kept = PushPolicy.load(tmp_path / "policy.npz")
    assert kept.arms == ["one", "two", "three"] and kept.training["unit"] == "mm"
    assert kept.training["simulated_s"] == pytest.approx(2 * 2 * 5 * 0.02)
    assert History.load(tmp_path / "history.json").rows == history.rows
    with pytest.raises(InputError, match="env: task: found 'fly', allowed are 'pressure', 'push'"):
        settings(env={"task": "fly"})


@pytest.mark.long
def test_training_improves_the_tracking():
    """A few iterations on a short horizon halve the error of a valve that stays closed."""
    learning = {"iterations": 12, "npg": {"value_steps": 50}, "evaluate_every": 12}
    longer = {**PLAIN["env"], "num_envs": 20, "horizon": 50, "kinds": ["smooth"]}
    trainer = Trainer(settings(**learning, env=longer))
    closed = roll_out(trainer.env, lambda seen: np.zeros((len(seen), 1)), 20_000).rmse
    for _ in range(12):
        trainer.iterate()
    assert trainer.rows[-1]["eval_rmse"] < 0.5 * closed


def test_a_run_leaves_a_policy_that_acts_as_the_network_does(tmp_path):
    trainer = Trainer(settings())
    seen = []
    history = trainer.run(tmp_path, seen.append)
    assert history.finished and len(seen) == 4
    policy = PolicyFile.load(tmp_path / "policy.npz")
    features = np.random.default_rng(0).standard_normal(policy.recipe.size)
    expected = mean_action(trainer.policy.weights(), features[None].astype(np.float32))
    assert policy.act(features) == pytest.approx(float(expected[0, 0]), abs=1e-6)
    assert policy.training["samples"] == 4 * 4 * 30
    assert policy.training["settings"] == json.loads(json.dumps(trainer.settings.plain()))
    policy.check_rig(trainer.env.rig)
    read = History.load(tmp_path / "history.json")
    assert untimed(read.rows) == untimed(trainer.rows)
    assert not [path for path in tmp_path.iterdir() if path.name.endswith(".part")]


def test_an_interrupt_ends_with_a_checkpoint_to_go_on_from(tmp_path, env):
    trainer = Trainer(settings(checkpoint_every=100), env)

    def interrupt(row):
        if row["iteration"] == 2:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        trainer.run(tmp_path, interrupt)
    assert not History.load(tmp_path / "history.json").finished
    again = Trainer(settings(checkpoint_every=100), env)
    again.resume(tmp_path / "checkpoint.pt")
    assert again.done == 2
    again.run(tmp_path)
    assert History.load(tmp_path / "history.json").finished


def test_average_is_the_exponential_one(env):
    trainer = Trainer(settings(average_decay=0.75), env)
    expected = trainer.policy.flat()
    for _ in range(3):
        trainer.iterate()
        expected = 0.75 * expected + 0.25 * trainer.policy.flat()
    exported = np.concatenate([part.ravel() for layer in trainer.weights() for part in layer])
    assert exported == pytest.approx(expected[:-1].numpy(), abs=1e-7)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda content: content[:-100], "cut short"),
        (lambda content: content[: len(content) // 2], "cut short"),
        (lambda content: content[:-9] + bytes([content[-9] ^ 1]) + content[-8:], "checksum"),
        (lambda content: content[:10], "is not a checkpoint"),
        (lambda content: b"", "is not a checkpoint"),
        (lambda content: content.replace(b"checkpoint 1", b"checkpoint 9", 1), "version 9"),
    ],
)
def test_a_damaged_checkpoint_is_one_sentence(tmp_path, damage, said):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint({"numbers": torch.arange(1000)}, path)
    assert torch.equal(load_checkpoint(path)["numbers"], torch.arange(1000))
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(InputError, match=said) as raised:
        load_checkpoint(path)
    assert str(path) in str(raised.value) and "\n" not in str(raised.value)


def test_a_checkpoint_of_other_settings_is_refused_by_the_setting(tmp_path, env):
    trainer = Trainer(settings(), env)
    trainer.iterate()
    trainer.save(tmp_path / "checkpoint.pt")
    Trainer(settings(iterations=9), env).resume(tmp_path / "checkpoint.pt")
    npg = {**PLAIN["npg"], "delta": 0.05}
    with pytest.raises(InputError, match=r"npg\.delta: found 0.1, wanted 0.05"):
        Trainer(settings(npg=npg), env).resume(tmp_path / "checkpoint.pt")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("npg: {delta: -1}", "npg.delta: Input should be greater than 0, found -1"),
        ("npg: {gama: 0.9}", "unknown key 'npg.gama'; did you mean 'gamma'"),
        ("npg: {hidden: 32}", "npg.hidden: Input should be a valid tuple, found 32"),
        ("seed: one", "seed: Input should be a valid integer, found 'one'"),
        ("iterations: 0", "iterations: Input should be greater than or equal to 1, found 0"),
        ("device: tpu", "found 'tpu'"),
        ("average_decay: .nan", "average_decay: Input should be a finite number, found nan"),
        ("npg: [", "is not YAML, line"),
    ],
)
def test_a_wrong_setting_is_named(tmp_path, text, said):
    path = tmp_path / "settings.yaml"
    path.write_text(f"env: {json.dumps(PLAIN['env'])}\n{text}\n")
    with pytest.raises(InputError, match=r".") as raised:
        load_settings(path)
    assert str(raised.value).startswith(f"{path}") and said in str(raised.value)


def test_settings_survive_the_way_through_plain_values():
    one = settings(npg={"hidden": [7, 5], "delta": 0.02})
    plain = json.loads(json.dumps(one.plain()))
    assert TrainSettings(**plain) == one
    assert set(TrainSettings.model_fields) == set(plain)


def test_an_environment_that_is_not_finite_ends_the_run(env):
    trainer = Trainer(settings(), env)
    before = env._noise
    env._noise = np.array([np.nan])
    try:
        with pytest.raises((FloatingPointError, ValueError), match=r"found readings|not finite"):
            trainer.iterate()
    finally:
        env._noise = before


def test_sweep_expands_to_all_combinations(tmp_path):
    document = {**PLAIN, "sweep": {"seed": [0, 1], "npg.delta": [0.05, 0.1], "env.num_envs": [4]}}
    runs = sweep.expand(document, tmp_path)
    assert [run.name for run in runs][:2] == [
        "seed-0_delta-0.05_num_envs-4",
        "seed-0_delta-0.1_num_envs-4",
    ]
    assert {(run.settings.seed, run.settings.npg.delta) for run in runs} == {
        (0, 0.05), (0, 0.1), (1, 0.05), (1, 0.1),
    }  # fmt: skip
    assert document["npg"] == PLAIN["npg"]
    with pytest.raises(InputError, match=r"unknown key .npg\.delt."):
        sweep.expand({**PLAIN, "sweep": {"npg.delt": [1.0]}}, tmp_path)


def test_a_failing_run_takes_no_other_with_it_and_finished_ones_are_kept(tmp_path):
    runs = sweep.expand({**PLAIN, "iterations": 2, "sweep": {"seed": [0, 1]}}, tmp_path)
    (tmp_path / "seed-0").write_text("in the way of the folder")
    outcomes = {o.run.name: o for o in sweep.train_all(runs, sweep.Workers(workers=1))}
    assert "seed-0" in outcomes["seed-0"].fault and outcomes["seed-0"].history is None
    assert outcomes["seed-1"].history.finished
    written = (tmp_path / "seed-1" / "policy.npz").stat().st_mtime_ns
    (tmp_path / "seed-0").unlink()
    again = {o.run.name: o for o in sweep.train_all(runs, sweep.Workers(workers=1))}
    assert all(outcome.fault is None for outcome in again.values())
    assert (tmp_path / "seed-1" / "policy.npz").stat().st_mtime_ns == written


def test_a_missing_cluster_is_one_sentence(tmp_path):
    if importlib.util.find_spec("ray"):
        pytest.skip("ray is installed")
    runs = sweep.expand(PLAIN, tmp_path)
    with pytest.raises(InputError, match="ray is not installed"):
        list(sweep.train_all(runs, sweep.Workers(backend="ray")))
    with pytest.raises(InputError, match="backend: found 'dask', allowed are loky, ray"):
        sweep.Workers(backend="dask")


def test_the_command_trains_refuses_and_resumes(tmp_path):
    app = typer.Typer()
    register_train(app)
    file = tmp_path / "settings.yaml"
    file.write_text(json.dumps({**PLAIN, "iterations": 2}))
    out = tmp_path / "out"

    def run(*more):
        return CliRunner().invoke(app, [str(file), "-o", str(out), *more])

    first = run("--seed", "5")
    assert first.exit_code == 0, first.output
    assert PolicyFile.load(out / "policy.npz").training["seed"] == 5
    other = run("--seed", "6")
    assert isinstance(other.exception, InputError)
    assert "seed: found 5, wanted 6" in str(other.exception)
    longer = run("--seed", "5", "--iterations", "3")
    assert isinstance(longer.exception, InputError) and "--resume" in str(longer.exception)
    assert run("--seed", "5", "--iterations", "3", "--resume").exit_code == 0
    assert PolicyFile.load(out / "policy.npz").training["iterations"] == 3


def test_learning_curves_are_drawn(tmp_path):
    def history(level):
        rows = [
            {"samples": 100 * n, "eval_score": -level / n, "eval_rmse": level / n}
            for n in range(1, 6)
        ]
        return History("npg", {}, rows, True)

    groups = {"one": [history(1.0), history(2.0)], "two": [history(0.5)]}
    learning_curves(groups, tmp_path / "curves.png", "Title")
    picture = imread(tmp_path / "curves.png")
    assert picture.shape[0] > 300 and np.std(picture) > 0.01
    with pytest.raises(InputError, match="no histories"):
        learning_curves({"one": []}, tmp_path / "none.png")
    with pytest.raises(InputError, match="drawn as 'xyz'"):
        learning_curves(groups, tmp_path / "curves.xyz")


def test_ppo_writes_the_same_history(tmp_path, monkeypatch):
    pytest.importorskip("stable_baselines3")
    from pneu_policy.learn.ppo import train_ppo

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    history = train_ppo(settings(iterations=2), n_epochs=1, batch_size=60)
    assert [row["samples"] for row in history.rows] == [120, 240]
    assert history.algorithm == "ppo" and history.rows[-1]["eval_rmse"] > 0.0
    reference = Trainer(settings()).iterate()
    assert set(history.rows[0]) <= set(reference)
    assert not list(tmp_path.glob("SB3*"))


def test_a_rig_file_that_changed_meanwhile_is_noticed(tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_bytes(Path(PLAIN["env"]["rig"]).read_bytes())
    changed = TrainSettings(**(PLAIN | {"env": PLAIN["env"] | {"rig": str(rig)}}))
    first = Trainer(changed)
    first.iterate()
    first.save(tmp_path / "checkpoint.pt")
    rig.write_text(rig.read_text() + "# another\n")
    with pytest.raises(InputError, match="as it was before it was changed"):
        Trainer(changed).resume(tmp_path / "checkpoint.pt")
