"""What a disturbance observer estimates of the air, term by term, against the equations written out in NumPy."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.spatial.transform import Rotation

from jax_aero.aero.network import baseline_areas, init_network, raw_output, to_base_axes
from jax_aero.train import Settings, fit, refit
from jax_aero.train.loop import ForceAreas
from jax_aero.train.wrench import CONSTANTS, ObservedWrenches, Windows, windows_of, wrench

STEP, ROWS, LINKS = 0.1, 30, 13
OBJECTIVE = ObservedWrenches(
    frame="link",
    layout="link",
    gain=(3.0, 2.0),
    step=STEP,
    noise=(3.0, 0.3),
    deviation=(12.0, 1.0, 12.0),
    area=0.02,
    shrink=0.02,
)
SHARES = np.repeat(1.0 - np.exp(-np.array([3.0, 2.0]) * STEP), 3)


def turns(count, rng):
    return np.asarray(Rotation.from_rotvec(rng.normal(size=(count, 3))).as_matrix())


def filtered(total, start):
    """M84 for a wrench that changes linearly between rows."""
    held, before, found = start, total[0], []
    for now in total:
        held = held + SHARES * (0.5 * (now + before) - held)
        before = now
        found.append(held)
    return np.array(found)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def made_up(rng, network=None, windows=1, settling=5):
    """Windows of a robot that turns about in a wind that changes, with nothing observed."""
    shape = (windows, ROWS)
    features = 1 if network is None else network.layers[0].weight.shape[-1]
    x = rng.normal(size=(*shape, features))
    copies = [x] if network is None or network.mirror is None else [x, x @ network.mirror.features.T]
    unit = rng.normal(size=(*shape, 3))
    axes = rng.normal(size=(LINKS, 3))
    weight = np.ones(shape)
    weight[:, :settling] = 0.0
    parts = {
        "x": np.stack(copies, axis=2),
        "turn": turns(np.prod(shape), rng).reshape(*shape, 3, 3),
        "pressure": rng.uniform(20.0, 90.0, size=shape),
        "wind": unit / np.linalg.norm(unit, axis=-1, keepdims=True),
        "rotations": turns(np.prod(shape) * LINKS, rng).reshape(*shape, LINKS, 3, 3),
        "axes": np.broadcast_to(axes / np.linalg.norm(axes, axis=1, keepdims=True), (*shape, LINKS, 3)),
        "arms": rng.normal(scale=0.3, size=(*shape, LINKS, 3)),
        "seen": np.zeros((*shape, 6)),
        "weight": weight,
    }
    blank = np.zeros(0, np.float32)
    float32 = {name: part.astype(np.float32) for name, part in parts.items()}
    return OBJECTIVE.with_constants(Windows(**float32, constants=blank, solve=blank))


def one(windows, number=0):
    return Windows(*(part[number] for part in windows))


def observed(windows, areas, constants=None):
    """Windows in which the observer estimated areas (W, T, L, 3), and constants (7,)."""
    seen = []
    for number in range(len(windows.x)):
        of = one(windows, number)
        total = np.array([wrench(*row) for row in zip(areas[number], of.arms, of.turn, of.pressure, strict=True)])
        if constants is not None:
            turned = [np.concatenate([turn @ constants[:3], turn @ constants[3:6]]) for turn in of.turn]
            total = total + np.array(turned) + constants[6] * np.eye(6)[2]
        seen.append(filtered(total, total[0]))
    return windows._replace(seen=np.array(seen, np.float32))


# --- the wrench --------------------------------------------------------------------------------------------------


def test_a_force_on_one_link_turns_with_the_robot_and_has_its_arm(rng, agree):
    areas, arms, turn = np.zeros((2, 3)), rng.normal(size=(2, 3)), turns(1, rng)[0]
    areas[1] = [0.1, -0.2, 0.3]
    force = 50.0 * turn @ areas[1]
    expected = np.concatenate([force, np.cross(turn @ arms[1], force)])
    agree("wrench", np.asarray(wrench(areas, arms, turn, 50.0)), expected, 1e-5)


def test_the_observer_forgets_by_its_gains_of_force_and_moment(agree):
    """A step that begins in row 1: half of it in that row, since it rises between rows."""
    total = np.ones((8, 6))
    total[0] = 0.0
    found = np.asarray(OBJECTIVE.filtered(total.astype(np.float32), np.zeros(6, np.float32)))
    agree("filter", found, filtered(total, np.zeros(6)), 1e-6)
    agree("first row", found[1], 0.5 * SHARES, 1e-6)
    left = 1.0 - found[:, [0, 5]]
    agree("decay", left[3:] / left[2:-1], np.tile(np.exp([-0.3, -0.2]), (5, 1)), 1e-5)


def test_a_balance_is_not_filtered(agree):
    balance = replace(OBJECTIVE, gain=(np.inf, np.inf))
    agree("balance", np.asarray(balance.filtered(np.ones((1, 6)), np.zeros(6))), np.ones((1, 6)), 0.0)


# --- constants ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", range(CONSTANTS))
def test_constants_explain_what_turns_with_the_robot_and_its_weight(rng, number):
    """Without a prior nothing is left but rounding; a constant of other axes is left."""
    free = replace(OBJECTIVE, deviation=(1e6, 1e6, 1e6))
    windows = free.with_constants(
        observed(made_up(rng), np.zeros((1, ROWS, LINKS, 3)), 5.0 * np.eye(CONSTANTS)[number])
    )
    left = free.errors(jnp.zeros((ROWS, LINKS, 3)), one(windows))
    assert np.abs(left.of_rows).max() < 1e-3
    np.testing.assert_allclose(left.constants, 5.0 * np.eye(CONSTANTS)[number], atol=2e-3)
    other = windows._replace(turn=np.swapaxes(windows.turn, -1, -2))
    if number < 6:
        assert np.abs(free.errors(jnp.zeros((ROWS, LINKS, 3)), one(free.with_constants(other))).of_rows).max() > 0.1


def test_a_prior_of_zero_allows_no_constant(rng):
    none = replace(OBJECTIVE, deviation=(0.0, 0.0, 0.0))
    windows = observed(made_up(rng), np.zeros((1, ROWS, LINKS, 3)), np.full(CONSTANTS, 3.0))
    found = none.errors(jnp.zeros((ROWS, LINKS, 3)), one(none.with_constants(windows)))
    np.testing.assert_array_equal(found.constants, 0.0)


def test_the_constants_are_the_best_ones(rng):
    """Any other constants leave more, with their prior: rows of one time constant count as one."""
    windows = observed(made_up(rng), rng.normal(scale=0.02, size=(1, ROWS, LINKS, 3)), np.full(CONSTANTS, 4.0))
    found = OBJECTIVE.errors(jnp.zeros((ROWS, LINKS, 3)), one(windows))
    sigma = np.repeat([3.0, 0.3], 3)
    deviation = np.repeat([12.0, 1.0, 12.0], [3, 3, 1])
    basis = (windows.weight[0][:, None] / sigma)[:, :, None] * windows.constants[0]
    held = filtered(np.zeros((ROWS, 6)), windows.seen[0][0])
    before = windows.weight[0][:, None] * (held - windows.seen[0]) / sigma

    def cost(constants):
        left = before + basis @ constants
        return np.sum(left**2) + np.sum((constants / deviation) ** 2) / (2.0 * STEP)

    best = cost(np.asarray(found.constants, float))
    np.testing.assert_allclose(found.of_rows, before + basis @ found.constants, atol=1e-4)
    for number in range(CONSTANTS):
        for change in (-0.05, 0.05):
            assert cost(np.asarray(found.constants, float) + change * np.eye(CONSTANTS)[number]) > best


# --- the loss ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def network(ironcub):
    return init_network(
        jax.random.key(0), ironcub, hidden=(8,), blocks=("link_wind",), mirror=True, frame="link", layout="link"
    )


def test_the_loss_is_errors_constants_and_sizes_of_areas(rng, network, agree):
    windows = made_up(rng, network, windows=2)
    windows = observed(windows, rng.normal(scale=0.01, size=(2, ROWS, LINKS, 3)), np.full(CONSTANTS, 2.0))
    scaled = OBJECTIVE.scaled(network, windows)
    output = rng.normal(size=(1, 2, ROWS, 2, 3 * LINKS)).astype(np.float32)
    given, common = OBJECTIVE.given(scaled, windows)
    total = 0.0
    for number in range(2):
        first, second = 0.02 * output[0, number].transpose(1, 0, 2)
        y = 0.5 * (first + second @ network.mirror.output.T.astype(np.float32))
        of = one(windows, number)
        areas = np.einsum("tlij,tlj->tli", of.rotations, y.reshape(ROWS, LINKS, 3))
        left = OBJECTIVE.errors(areas, of)
        counted = of.weight.sum()
        prior = np.sum((left.constants / np.repeat([12.0, 1.0, 12.0], [3, 3, 1])) ** 2) / (2.0 * STEP)
        size = np.sum(of.weight[:, None, None] * (areas / 0.02) ** 2) / (3 * LINKS)
        total += ((np.sum(left.of_rows**2) + prior) / 6.0 + 0.02 * size) / counted / 2.0
    agree("loss", float(OBJECTIVE.loss(output, given, common)), float(total), 1e-4)


def test_rows_that_do_not_count_change_nothing(rng, network):
    windows = made_up(rng, network)
    output = rng.normal(size=(1, 1, ROWS, 2, 3 * LINKS)).astype(np.float32)
    found = []
    for late in (0.0, 1.0):
        seen = windows.seen.copy()
        seen[:, 1:5] += late  # the first row is what the observer holds
        given, common = OBJECTIVE.given(OBJECTIVE.scaled(network, windows), windows._replace(seen=seen))
        found.append(float(OBJECTIVE.loss(output, given, common)))
    assert found[0] == found[1]


def test_a_training_begins_with_the_baseline_and_its_error_is_that_of_flight(rng, ironcub, network, agree):
    rows = np.asarray(ironcub.aero_links.coefficients["signed"], np.float32)
    begun = OBJECTIVE.scaled(replace(network, baseline=rows), None)
    windows = made_up(rng, network)
    np.testing.assert_array_equal(raw_output(begun, windows.x[0, 0, 0]), 0.0)
    left = refit.left(rows, windows, OBJECTIVE)
    np.testing.assert_allclose(OBJECTIVE.evaluate(begun, windows).of_rows, left.of_rows, atol=1e-4)
    random = replace(network, scale=0.02 * network.scale)
    of = one(windows)
    areas = [
        to_base_axes("link", "link", raw_output(random, x[0]), turn) for x, turn in zip(of.x, of.rotations, strict=True)
    ]
    alone = OBJECTIVE.errors(np.array(areas), of).of_rows
    squares = np.sum(np.square(alone)) / (6.0 * of.weight.sum())
    agree("error of flight", OBJECTIVE.error(random, windows), float(squares), 1e-4)


def test_a_network_learns_what_the_observer_saw(rng, network):
    """A few steps of the loop, from windows whose wrench a network of the same kind made."""
    teacher = replace(network, scale=0.02 * network.scale)
    windows = made_up(rng, network, windows=6)
    areas = np.array(
        [
            [to_base_axes("link", "link", raw_output(teacher, x[0]), turn) for x, turn in zip(*rows, strict=True)]
            for rows in zip(windows.x, windows.rotations, strict=True)
        ]
    )
    windows = OBJECTIVE.with_constants(observed(windows, areas, np.full(CONSTANTS, 1.0)))
    settings = Settings(epochs=150, learning_rate=2e-2, batch=3, schedule="cosine", validate_every=150)
    found = fit(network, windows, windows, settings, 0, objective=OBJECTIVE)
    before = OBJECTIVE.error(OBJECTIVE.scaled(network, windows), windows)
    assert found.error < 0.2 * before
    assert hash(OBJECTIVE) != hash(ForceAreas())


# --- the refit ---------------------------------------------------------------------------------------------------


def test_the_refit_finds_the_coefficients_that_made_the_wrench(rng, ironcub):
    """Left and right alike; constants are found beside them. Many rows, so that its prior is weak."""
    truth = np.asarray(ironcub.aero_links.coefficients["signed"], np.float64)
    windows = made_up(rng, windows=6)
    areas = [
        [baseline_areas(truth, *row) for row in zip(*rows, strict=True)]
        for rows in zip(windows.wind, windows.axes, strict=True)
    ]
    sharp = replace(OBJECTIVE, noise=(0.03, 0.003))
    windows = sharp.with_constants(observed(windows, np.array(areas), np.full(CONSTANTS, 2.0)))
    found = refit.refit(ironcub, windows, sharp, np.zeros_like(truth))
    rest = sharp.rms(refit.left(found, windows, sharp), windows)
    usual = sharp.rms(refit.left(np.zeros_like(truth), windows, sharp), windows)
    assert rest[0] < 0.01 * usual[0]
    assert rest[1] < 0.01 * usual[1]
    np.testing.assert_allclose(found, truth, atol=0.05 * np.abs(truth).max())


def test_a_refit_shares_the_coefficients_of_left_and_right(ironcub):
    pairs = refit._pairs(ironcub.aero_links.names)
    assert sorted(link for pair in pairs for link in pair) == list(range(LINKS))
    for pair in pairs:
        one, other = (ironcub.aero_links.names[link] for link in (pair[0], pair[-1]))
        assert other in (one, one.replace("l_", "r_"), one.replace("r_", "l_"), one.replace("left", "right"))
    card = refit.as_network(ironcub, np.ones((LINKS, 6)))
    np.testing.assert_array_equal(raw_output(card, np.ones(3)), 0.0)


# --- windows -----------------------------------------------------------------------------------------------------


def test_windows_cover_a_flight_and_rows_settle():
    found = windows_of(205, 100, np.ones(205, dtype=bool), 20)
    assert [(part.start, part.stop) for part, _ in found] == [(0, 100), (105, 205)]
    for _, weight in found:
        assert weight.tolist() == [0.0] * 20 + [1.0] * 80
    assert len(windows_of(250, 100, np.ones(250, dtype=bool), 20)) == 3
    gap = np.ones(100, dtype=bool)
    gap[50] = False
    weight = windows_of(100, 100, gap, 20)[0][1]
    assert np.flatnonzero(weight == 0.0).tolist() == [*range(20), *range(50, 71)]
    assert windows_of(1, 1, np.ones(1, dtype=bool), 0)[0][1].tolist() == [1.0]
