"""Our CrossQ as a model of SB3: files, what it does not know, threads, batches that are wrong."""

import copy
import threading
import time
from dataclasses import fields, replace

import numpy as np
import pytest

pytest.importorskip("sb3_contrib")
import torch
from sb3_contrib import CrossQ

from frasa_rl.batches import Batches
from frasa_rl.crossq import FastCrossQ


def some_batches(count=7, size=32, seen=22, acted=5, seed=0):
    rng = np.random.default_rng(seed)

    def normal(*shape):
        return rng.normal(size=(count, size, *shape)).astype(np.float32)

    ends = (rng.random((count, size)) < 0.1).astype(np.float32)
    discounts = np.full((count, size), 0.97, np.float32)
    actions = np.tanh(normal(acted))
    return Batches(normal(seen), actions, normal(seen), normal(), ends, discounts, normal(acted), normal(acted))


def bytes_of(model):
    weights = [value.numpy().tobytes() for value in model.policy.state_dict().values()]
    moments = [
        value.numpy().tobytes()
        for optimizer in (model.actor.optimizer, model.critic.optimizer)
        for state in optimizer.state.values()
        for value in state.values()
    ]
    return weights, moments, model.log_ent_coef.detach().numpy().tobytes()


def state_of_numpy():
    state = np.random.get_state()  # noqa: NPY002 - SB3 draws from it
    return state[1].tobytes(), state[2]


def test_ours_loads_in_sb3_contrib_and_acts_the_same(crossq_model, tmp_path):
    """A file of ours is a file of sb3-contrib: the same actions bit for bit, the same moments."""
    model = crossq_model(FastCrossQ)
    model.train(12, 64)
    model.save(tmp_path / "ours")
    loaded = CrossQ.load(tmp_path / "ours", device="cpu")
    seen = np.random.default_rng(0).normal(size=(100, 22)).astype(np.float32)
    assert np.array_equal(loaded.predict(seen, deterministic=True)[0], model.predict(seen, deterministic=True)[0])
    assert bytes_of(loaded) == bytes_of(model)


def test_a_file_of_sb3_contrib_goes_on_the_same_here(crossq_model, tmp_path):
    """A model of sb3-contrib loads here, acts bit for bit the same and learns on from the same moments."""
    model = crossq_model(CrossQ, learning_rate=3e-4)
    model.train(12, 64)
    model.save(tmp_path / "theirs")
    loaded = FastCrossQ.load(tmp_path / "theirs", env=model.env, device="cpu")
    loaded.set_logger(model.logger)
    loaded.replay_buffer = model.replay_buffer
    seen = np.random.default_rng(0).normal(size=(100, 22)).astype(np.float32)
    assert loaded.fast
    assert np.array_equal(loaded.predict(seen, deterministic=True)[0], model.predict(seen, deterministic=True)[0])
    for one in (model, loaded):
        torch.manual_seed(1)
        np.random.seed(1)  # noqa: NPY002 - SB3 draws from it
        one.train(3, 64)
    for name, value in model.policy.state_dict().items():
        assert torch.allclose(loaded.policy.state_dict()[name], value, atol=1e-4), name
    assert loaded._n_updates == model._n_updates == 15


def test_parameters_set_after_learning_are_learned_from(crossq_model):
    """Weights put into a model that has learned already are those it goes on from."""
    model, other = crossq_model(FastCrossQ), crossq_model(FastCrossQ, seed=8)
    other.update(some_batches())
    model.update(some_batches(seed=3))
    model.set_parameters(other.get_parameters())
    model._n_updates = other._n_updates
    with torch.no_grad():
        model.log_ent_coef.copy_(other.log_ent_coef)
    for one in (model, other):
        one.update(some_batches(seed=4))
    assert bytes_of(model) == bytes_of(other)


def test_a_copy_learns_on_its_own(crossq_model):
    """A deep copy has numbers of its own, and the same."""
    model = crossq_model(FastCrossQ)
    model.update(some_batches())
    other = copy.deepcopy(model)
    before = bytes_of(model)
    other.update(some_batches(seed=1))
    assert bytes_of(model) == before
    model.update(some_batches(seed=1))
    assert bytes_of(model) == bytes_of(other)


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"use_sde": True}, "gSDE"),
        ({"policy": {"activation_fn": torch.nn.Tanh}}, "ReLU"),
        ({"policy": {"batch_norm": False}}, "batch renormalisation"),
        ({"policy": {"optimizer_class": torch.optim.RMSprop}}, "Adam"),
        ({"policy": {"optimizer_kwargs": {"weight_decay": 0.1}}}, "weight decay"),
        ({"pi": ()}, "hidden layers"),
    ],
)
def test_what_it_does_not_know_is_learned_as_before(crossq_model, settings, word):
    """Then `train` is sb3-contrib's own, bit for bit, and `update` says what is in the way."""
    models = [crossq_model(kind, **settings) for kind in (CrossQ, FastCrossQ)]
    for model in models:
        torch.manual_seed(2)
        np.random.seed(2)  # noqa: NPY002 - SB3 draws from it
        model.train(4, 16)
    assert not models[1].fast
    assert word in models[1].obstacle
    assert bytes_of(models[0]) == bytes_of(models[1])
    with pytest.raises(ValueError, match="do not know"):
        models[1].update(some_batches())


def test_the_same_again_and_in_a_thread(crossq_model):
    """The same batches give the same bytes, whichever thread learns; two calls give what one gives."""
    results = []
    for way in ("once", "again", "thread", "two calls"):
        model, batches = crossq_model(FastCrossQ), some_batches(8)
        if way == "thread":
            thread = threading.Thread(target=model.update, args=(batches,))
            thread.start()
            thread.join()
        elif way == "two calls":
            for part in (slice(0, 5), slice(5, 8)):
                model.update(Batches(*(getattr(batches, field.name)[part] for field in fields(batches))))
        else:
            model.update(batches)
        results.append(bytes_of(model))
    assert all(result == results[0] for result in results)


def test_other_threads_run_meanwhile(crossq_model):
    """Python goes on while updates are made in another thread."""
    model = crossq_model(FastCrossQ)
    model.update(some_batches())  # compiled
    batches, ticks = some_batches(1000, 128), 0
    thread = threading.Thread(target=model.update, args=(batches,))
    thread.start()
    while thread.is_alive():
        time.sleep(0.001)
        ticks += 1
    assert ticks > 20


def test_global_random_numbers_are_left_alone(crossq_model):
    """`update` draws nothing from torch's or numpy's generator."""
    model = crossq_model(FastCrossQ)
    before = torch.get_rng_state(), state_of_numpy()
    losses = model.update(some_batches())
    assert torch.equal(torch.get_rng_state(), before[0])
    assert state_of_numpy() == before[1]
    assert all(np.isfinite([losses.critic, losses.actor, losses.entropy, losses.entropy_loss]))


def test_no_update_of_the_policy_is_no_number(crossq_model):
    """Two updates of a policy that learns every third have no loss of the policy."""
    losses = crossq_model(FastCrossQ).update(some_batches(2))
    assert np.isnan(losses.actor)
    assert np.isnan(losses.entropy_loss)


@pytest.mark.parametrize("name", [field.name for field in fields(Batches)])
def test_wrong_batches_are_refused(crossq_model, name):
    """A shape that does not fit and a number that is none are named in one line, before anything changes."""
    model, batches = crossq_model(FastCrossQ), some_batches()
    before = model.policy.state_dict()["actor.mu.weight"].clone()
    broken = getattr(batches, name).copy()
    broken.flat[3] = np.nan
    with pytest.raises(ValueError, match=f"{name} of the batches hold a number that is not finite"):
        model.update(replace(batches, **{name: broken}))
    with pytest.raises(ValueError, match="of the batches have shape"):
        model.update(replace(batches, **{name: getattr(batches, name)[:, :-1]}))
    assert torch.equal(model.policy.state_dict()["actor.mu.weight"], before)


def test_weight_norm_keeps_lengths(crossq_model, tmp_path):
    """Weights of hidden layers keep their first Frobenius norms, the last layers' are free; a file keeps the switch."""
    model = crossq_model(FastCrossQ, weight_norm=True)
    hidden = [name for name in model.policy.state_dict() if name.endswith((".1.weight", ".4.weight"))]
    assert len(hidden) == 6

    def lengths():
        return [float(model.policy.state_dict()[name].norm()) for name in (*hidden, "critic.qf0.7.weight")]

    before = lengths()
    model.update(some_batches(30))
    after = lengths()
    assert after[:-1] == pytest.approx(before[:-1], rel=1e-5)
    assert abs(after[-1] - before[-1]) > 1e-3
    model.save(tmp_path / "kept")
    assert FastCrossQ.load(tmp_path / "kept", device="cpu").weight_norm
    CrossQ.load(tmp_path / "kept", device="cpu")
