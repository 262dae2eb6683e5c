import shutil

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.patches import Rectangle
from PIL import Image

from jax_aero import rust
from jax_aero.base import flights
from jax_aero.base.quantities import shown_array
from jax_aero.commands import replay
from jax_aero.commands.figures import main
from jax_aero.figures import panels, runs, style
from jax_aero.figures.catalogue import FIGURES
from jax_aero.figures.panels import readable_name


def is_made_up(run: str) -> bool:
    """Whether a flight is like those that are made up here: of the crate, which has no ground."""
    return rust.load_config(run)["backend"] == "rust"


# The tests of each study draw its figure from a study of their own, those of the ground figures of flights from it.
DRAWN = [name for name, entry in FIGURES.items() if entry.kind in ("", "flight") and all(map(is_made_up, entry.runs))]


@pytest.mark.slow
@pytest.mark.parametrize("name", DRAWN)
def test_every_figure_is_drawn_as_pdf_and_png_and_names_its_runs(name, made_up_results, tmp_path):
    is_of_any = FIGURES[name].kind == "flight" and not FIGURES[name].runs
    runs = ["test1", "test2", "test4"] if is_of_any else []
    chosen = ["--runs", *runs] if runs else []
    assert main([name, *chosen, "--results", str(made_up_results), "--out", str(tmp_path / "out")]) == 0
    file = tmp_path / "out" / "--".join([name, *(["_".join(runs)] if runs else [])])
    assert file.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    with Image.open(file.with_suffix(".png")) as picture:
        assert picture.width >= 800  # on paper 101 mm, at 200 points an inch
        assert round(picture.info["dpi"][0]) == 200
        for run in runs or FIGURES[name].runs:
            assert f"{run} config {run.encode().hex()}" in picture.info["Description"]


@pytest.mark.slow
def test_the_runs_of_a_figure_can_be_chosen(made_up_results, tmp_path):
    arguments = ["fig5", "--runs", "test2", "test1_published"]
    arguments += ["--results", str(made_up_results), "--out", str(tmp_path)]
    assert main(arguments) == 0
    # What is called fig5 shows the runs of Fig. 5: a report takes it for that.
    assert {path.stem for path in tmp_path.iterdir()} == {"fig5--test2_test1_published"}
    assert main([*arguments[:3], "test1", *arguments[4:]]) == 0
    assert (tmp_path / "fig5.png").is_file()


@pytest.mark.slow
def test_flights_of_any_folder_are_drawn_beside_each_other(made_up_results, tmp_path, capsys):
    words = ["compare", "--results", str(made_up_results), "--out", str(tmp_path), "--runs", "test1_published"]
    words.append(str(made_up_results / "flight" / "test2"))
    assert main(words) == 0
    assert [path.stem for path in tmp_path.glob("*.png")] == ["compare--test1_published_test2"]
    assert [runs.load(made_up_results, name).attrs["name"] for name in words[-2:]] == ["test1_published", "test2"]
    assert runs.load(made_up_results, words[-1], "gain $k_o$").attrs["title"] == "gain $k_o$"
    assert main([*words, "--labels", "gain $k_o$", r"5 $ or $\x"]) == 0
    assert main([*words, "--labels", "one"]) == 2
    assert "compare has 2 runs, not 1 as --labels" in capsys.readouterr().err
    assert main([*words[:-1], f"{tmp_path}/none"]) == 1
    assert f"no flight in `{tmp_path}/none`" in capsys.readouterr().err


def test_a_missing_flight_is_named_with_the_command_that_flies_it(tmp_path, capsys):
    assert main(["fig5", "--results", str(tmp_path), "--out", str(tmp_path)]) == 1
    answer = capsys.readouterr().err
    assert "no flight `test2`" in answer
    assert f"jax-aero fly test2 --out {tmp_path / 'flight'}" in answer
    assert "there are" not in answer


def test_for_a_missing_flight_those_with_changes_are_named(made_up_results, tmp_path, capsys):
    shutil.copytree(made_up_results / "flight" / "test2", tmp_path / "flight" / "test2--simulator.duration=8")
    assert main(["compare", "--results", str(tmp_path), "--out", str(tmp_path), "--runs", "test2"]) == 1
    assert "there are test2--simulator.duration=8; fly it with" in capsys.readouterr().err


def test_a_wrong_number_of_runs_is_named(capsys):
    assert main(["fig5", "--runs", "test2"]) == 2
    assert "fig5 shows 2 runs, not 1" in capsys.readouterr().err


def test_a_figure_for_a_dark_page_has_no_background_and_light_text(tmp_path):
    figure = style.figure(1.0, 1.0)
    figure.text(0.5, 0.5, "█", color=style.VERMILION, size=40, ha="center", va="center")
    figure.add_artist(Rectangle((0.0, 0.0), 0.1, 0.1, color=style.BLACK))
    *_, light, dark = style.save(figure, "f", tmp_path, {}, dark=True)
    assert [light.name, dark.name] == ["f.png", "f_dark.png"]
    with Image.open(light) as before, Image.open(dark) as after:
        assert before.getpixel((0, 0)) == (255, 255, 255, 255)
        assert after.getpixel((0, 0))[3] == 0
        assert after.getpixel((5, after.height - 5)) == (255, 255, 255, 255)
        was, shown = (
            np.array(picture.getpixel((picture.width // 2, picture.height // 2))[:3], int)
            for picture in (before, after)
        )
        assert np.ptp(shown - was) <= 1  # of equal hue
        assert abs(shown.max() + was.min() - 255) <= 1  # of opposite lightness


def test_a_dollar_in_a_title_is_one(made_up_results):
    dear = runs.load(made_up_results, "test1", r"$\x$")
    figure = style.figure(3.0)
    style.title(figure, dear.attrs["title"])
    figure.canvas.draw()
    assert [runs.escape_text(text) for text in ("$k_o$", r"$\x$", "5 $")] == ["$k_o$", r"\$\x\$", r"5 \$"]


def test_joint_errors_are_summed_by_group_and_shown_in_degrees(made_up_results):
    run = runs.load(made_up_results, "test2")
    errors = flights.joint_error_sums(run)
    assert errors["group"].values.tolist() == ["torso", "left_arm", "right_arm", "left_leg", "right_leg"]
    joints = run["joint_position"] - run["joint_setpoint"]
    torso = np.abs(joints.values[:, :3]).sum(axis=1)
    np.testing.assert_allclose(errors.sel(group="torso"), torso)
    shown = shown_array(errors)
    np.testing.assert_allclose(shown.values.sel(group="torso"), np.degrees(torso))
    assert shown.unit == "deg"
    assert flights.joint_error_sums(run.isel(joint=[])).shape == (run.sizes["time"], 0)


@pytest.mark.parametrize("count", [0, 1, 3, 8])
def test_every_jet_and_every_group_of_joints_is_drawn(made_up_results, count):
    """Each in a look of its own, named in a legend; the rest of the figure stands without any."""
    run = runs.load(made_up_results, "test1")
    names = [f"part_{number}" for number in range(count)]
    parts = {"jet": [number % 4 for number in range(count)], "joint": list(range(count))}
    other = run.isel(parts).assign_coords(jet=names, joint_group=("joint", names))
    figure = style.figure(3.0)
    panels.row(figure, other, "abc")
    figure.canvas.draw()
    errors, _, thrusts = figure.axes
    for axes in (errors, thrusts):
        assert len({(line.get_color(), line.get_linestyle()) for line in axes.lines}) == len(axes.lines) == count
        shown = [text.get_text() for text in axes.get_legend().get_texts()] if count else []
        assert shown == [name.replace("_", " ") for name in names]


def test_nothing_behind_a_fall_is_shown(made_up_results):
    run = runs.load(made_up_results, "test1_published")
    assert flights.lost_time(run) == 21.5
    assert flights.until_loss(run)["time"].values[-1] <= 21.5
    assert flights.lost_time(runs.load(made_up_results, "test1")) is None


def test_how_a_flight_was_lost_stands_once_in_its_row(made_up_results):
    figure, _ = FIGURES["suppl7"].draw_from_results(made_up_results, ("test1", "test2", "test3", "test1_published"))
    assert [text.get_text() for axes in figure.axes for text in axes.texts].count("fell at 21.5 s") == 1


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("l_arm_jet_turbine", "left arm"),
        ("r_arm_jet", "right arm"),
        ("chest_l_jet_turbine", "left chest"),
        ("right_leg", "right leg"),
        ("torso", "torso"),
    ],
)
def test_names_become_words(name, words):
    assert readable_name(name) == words


def test_figures_do_not_depend_on_the_settings_of_their_user(tmp_path):
    """Also those of commands outside this folder, which draw in this style."""

    def drawn(name):
        log = {"time": np.arange(3.0), "thrust": np.ones((3, 4))}
        replayed = log | {"thrust": np.zeros((3, 4))}
        differences = replay.compare(log, replayed)
        robot = rust.Robot(rust.load_config("test2")["robot"])
        replay._draw(log, replayed, differences, robot, tmp_path / f"{name}_replay.png")
        return [path.read_bytes() for path in sorted(tmp_path.glob(f"{name}_*.png"))]

    ours = drawn("ours")
    with mpl.rc_context({"text.usetex": True, "font.size": 30.0, "axes.facecolor": "red", "lines.linestyle": ":"}):
        assert drawn("theirs") == ours
        style.use()
        changed = {key for key, value in mpl.rcParams.items() if value != mpl.rcParamsDefault[key]}
        assert changed <= {*style.SETTINGS, "backend", "backend_fallback"}
