# SPDX-License-Identifier: Apache-2.0
"""The file of a policy: it comes back as it was, and nothing else is taken for one."""

import json
import zipfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_policy.control.identity import rig_identity
from pneu_policy.control.observations import Recipe
from pneu_policy.control.policy_file import PolicyFile
from pneu_sim.rig import load_rig

ROOT = Path(__file__).parents[3]
RECIPE = Recipe(tap="end", taps=("valve_out", "middle", "end"), preview_s=(0.0, 0.05, 0.2), past=1)


@pytest.fixture(scope="module")
def rig():
    return load_rig(ROOT / "rigs/rig_a_fitted.yaml")


def make_policy(rig, recipe=RECIPE, seed=0):
    rng = np.random.default_rng(seed)
    sizes = [recipe.size, 32, 32, 1]
    weights = [
        (
            rng.normal(size=(n, m)).astype(np.float32) / np.float32(np.sqrt(m)),
            rng.normal(size=n).astype(np.float32),
        )
        for m, n in pairwise(sizes)
    ]
    training = {"algorithm": "none", "seed": seed, "rmse_pa": 1234.5}
    return PolicyFile(weights, recipe, rig_identity(rig), training, log_std=-1.5)


def test_a_policy_comes_back_as_it_was(rig, tmp_path):
    policy = make_policy(rig)
    policy.save(tmp_path / "one.npz")
    again = PolicyFile.load(tmp_path / "one.npz")
    assert again.recipe == RECIPE and again.rig == policy.rig and again.training == policy.training
    assert again.log_std == -1.5 and again.path == tmp_path / "one.npz"
    features = np.random.default_rng(1).normal(size=(100, RECIPE.size))
    assert [again.act(f) for f in features] == [policy.act(f) for f in features]
    assert not list(tmp_path.glob(".*"))


def test_the_same_policy_has_the_same_bytes_and_another_has_not(rig, tmp_path):
    for name, seed in (("one", 0), ("two", 0), ("three", 1)):
        make_policy(rig, seed=seed).save(tmp_path / name)
    one, two, three = ((tmp_path / name).read_bytes() for name in ("one", "two", "three"))
    assert one == two != three
    assert len(one) < 20_000


def test_its_action_is_that_of_the_network_written_out(rig):
    policy = make_policy(rig)
    features = np.random.default_rng(2).normal(size=RECIPE.size)
    value = [float(f) for f in features]
    for n, (weight, bias) in enumerate(policy.weights):
        value = [
            sum(float(w) * v for w, v in zip(row, value, strict=True)) + float(b)
            for row, b in zip(weight, bias, strict=True)
        ]
        value = [float(np.tanh(v)) for v in value] if n < 2 else value
    assert policy.act(features) == pytest.approx(value[0], abs=1e-12)


def test_numpy_opens_it_without_pickles(rig, tmp_path):
    make_policy(rig).save(tmp_path / "one.npz")
    with np.load(tmp_path / "one.npz", allow_pickle=False) as arrays:
        assert arrays["weight_0"].shape == (32, RECIPE.size)
        assert json.loads(arrays["about"].tobytes())["pneu_policy"] == 1


def test_every_cut_and_every_flipped_bit_is_refused_or_harmless(rig, tmp_path):
    path = tmp_path / "one.npz"
    policy = make_policy(rig)
    policy.save(path)
    content = path.read_bytes()
    features = np.linspace(-1.0, 1.0, RECIPE.size)
    rng = np.random.default_rng(3)
    refused = 0
    for k in range(300):
        damaged = bytearray(content)
        if k < 40:
            damaged = damaged[: rng.integers(len(content))]
        else:
            damaged[rng.integers(len(content))] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            again = PolicyFile.load(path)
        except InputError as error:
            refused += 1
            assert str(path) in str(error) and "\n" not in str(error)
        else:  # the flip met a field that means nothing, such as a date
            assert k >= 40 and again.act(features) == policy.act(features)
    assert refused > 200


@pytest.mark.parametrize(
    ("content", "told"),
    [(None, "no such policy file"), (b"", "no policy file"), (b"pneu_rig: 1", "no policy file")],
)
def test_what_is_no_policy_is_refused(tmp_path, content, told):
    path = tmp_path / "one.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=told):
        PolicyFile.load(path)


def rewritten(path, name, change):
    """Writes one array of a file anew."""
    with np.load(path) as arrays:
        held = dict(arrays)
    held[name] = change(held[name])
    np.savez(path, **held)


def about_with(**changes):
    def change(array):
        about = json.loads(array.tobytes())
        return np.frombuffer(json.dumps({**about, **changes}).encode(), dtype=np.uint8)

    return change


@pytest.mark.parametrize(
    ("name", "change", "told"),
    [
        ("weight_1", lambda w: w[:, :5], "layer 1.*32 inputs"),
        ("weight_2", lambda w: np.full_like(w, np.nan), "layer 2.*not finite"),
        ("bias_0", lambda b: np.array([object()]), "damaged"),
        ("about", about_with(pneu_policy=7), "found 7, this version reads 1"),
        ("about", about_with(recipe={"tap": "end"}), "taps: Field required"),
        ("about", about_with(rig={"name": "x"}), "rig:"),
        ("about", lambda a: a[:-5], "is no policy file"),
    ],
)
def test_arrays_that_make_no_policy_are_refused(rig, tmp_path, name, change, told):
    path = tmp_path / "one.npz"
    make_policy(rig).save(path)
    rewritten(path, name, change)
    with pytest.raises(InputError, match=told):
        PolicyFile.load(path)


def test_it_runs_on_the_rig_however_that_is_modelled_and_calibrated_and_on_no_other(rig):
    policy = make_policy(rig)
    for same in ("rig_a", "rig_a_thin_plate"):
        policy.check_rig(load_rig(ROOT / f"rigs/{same}.yaml"))
    with pytest.raises(InputError, match=r"'rig_a', found rig 'rig_b': pipe 'tube' is 5 m long"):
        policy.check_rig(load_rig(ROOT / "rigs/rig_b_fitted.yaml"))
    with pytest.raises(InputError, match="found rig 'ventilator'"):
        policy.check_rig(load_rig(ROOT / "rigs/ventilator.yaml"))


def test_a_recipe_of_taps_that_the_rig_has_not_is_refused(rig):
    with pytest.raises(InputError, match="'nose'"):
        make_policy(rig, RECIPE.but(taps=("end", "nose")))


def test_a_folder_that_is_not_there_is_named(rig, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        make_policy(rig).save(tmp_path / "nowhere" / "one.npz")


def test_an_entry_that_unpacks_without_end_is_refused(rig, tmp_path):
    path = tmp_path / "one.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("about.npy", bytes(65 * 2**20))
    with pytest.raises(InputError, match="too large"):
        PolicyFile.load(path)
