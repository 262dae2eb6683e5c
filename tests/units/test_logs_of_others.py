"""Tables and messages as other programs write them: formats, texts, and units of time."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from jax_aero import __main__ as commands
from jax_aero import rust
from jax_aero.base.terminal import Refused
from jax_aero.view import logs, measured

EXPERIMENT = "platform_hover"
PERIOD = 0.01
ROWS = 40
SIGNALS = {
    "raw_base_position": ["x", "y", "z"],
    "raw_base_quaternion": ["qw", "qx", "qy", "qz"],
    "raw_base_velocity": ["vx", "vy", "vz", "p", "q", "r"],
    "raw_thrust": [f"f{place}" for place in range(8)],
    "raw_wind": ["wx", "wy", "wz"],
}


@pytest.fixture(scope="module")
def config():
    return rust.load_config(EXPERIMENT)


@pytest.fixture(scope="module")
def signals(config):
    jets = len(rust.Robot(config["robot"]).jet_names)
    return SIGNALS | {"raw_thrust": SIGNALS["raw_thrust"][:jets]}


@pytest.fixture(scope="module")
def table(signals):
    """A robot that climbs at 1 m/s."""
    names = [name for columns in signals.values() for name in columns]
    rows = pd.DataFrame(0.0, index=range(ROWS), columns=names)
    return rows.assign(z=PERIOD * np.arange(ROWS), qw=1.0, vz=1.0)


SECONDS = PERIOD * np.arange(ROWS)


def mapping(folder, signals, time='columns = "t"', **more):
    """Write a file that names the columns; `more` are further keys of a signal."""
    lines = [f"time = {{ {time} }}"]
    for name, columns in signals.items():
        lines.append(f"{name} = {{ columns = {json.dumps(columns)}{', ' + more[name] if name in more else ''} }}")
    (folder / "map.toml").write_text("\n".join(lines))
    return folder / "map.toml"


def ticks(path, config, columns):
    log = logs.read(path, config, columns)
    return measured.at_ticks(log, rust.Robot(config["robot"]), PERIOD, Path(path.name))


def check(found):
    """The log is that of `table`."""
    np.testing.assert_allclose(found.signals["time"], SECONDS, atol=1e-9)
    np.testing.assert_allclose(found.signals["raw_base_position"][:, 2], SECONDS, atol=1e-12)
    assert found.is_recorded.all()


# --- units of time

START = pd.Timestamp("2026-03-01T12:00:00.25")
MOMENTS = START + pd.to_timedelta((SECONDS * 1e9).round(), unit="ns")


@pytest.mark.parametrize("scale", ["", ", scale = 1e-9", ", scale = 1e-3"])
@pytest.mark.parametrize(
    "times",
    [
        MOMENTS.astype("datetime64[ms]"),
        MOMENTS.astype("datetime64[us]"),
        MOMENTS.astype("datetime64[ns]"),
        MOMENTS.tz_localize("Asia/Tokyo").as_unit("us"),
        (MOMENTS - START).astype("timedelta64[ms]"),
        [moment.isoformat() for moment in MOMENTS],
    ],
    ids=["ms", "us", "ns", "zone", "duration", "text"],
)
def test_a_column_with_a_unit_has_it_whatever_the_scale_says(times, scale, table, signals, config, tmp_path):
    path = tmp_path / "log.parquet"
    table.assign(t=times).to_parquet(path)
    check(ticks(path, config, mapping(tmp_path, signals, f'columns = "t"{scale}')))


@pytest.mark.parametrize("form", ["{:%Y-%m-%dT%H:%M:%S.%fZ}", "{:%Y-%m-%d %H:%M:%S.%f}000+02:00"])
def test_times_in_words_of_iso_8601_have_a_unit(form, table, signals, config, tmp_path):
    path, columns = tmp_path / "log.csv", mapping(tmp_path, signals, 'columns = "t", scale = 1e-3')
    words = [form.format(moment) for moment in MOMENTS]
    table.assign(t=words).to_csv(path, index=False)
    check(ticks(path, config, columns))
    for row in (0, 7, ROWS - 1):
        for wrong in ("noon", "2026-02-30T10:00:00.020", "2026-12-31T23:59:60Z", "0.5", "12:00:00.250"):
            table.assign(t=[*words[:row], wrong, *words[row + 1 :]]).to_csv(path, index=False)
            said = rf"^column t in line {row + 2} of .* is {re.escape(wrong)}; expected ISO 8601, as in most rows$"
            with pytest.raises(Refused, match=said):
                ticks(path, config, columns)
            table.assign(t=[*words[:row], wrong, *words[row + 1 :]]).to_parquet(tmp_path / "log.parquet")
            said = rf"^column `t` in row {row + 1} of .* is {re.escape(wrong)}; expected ISO 8601, as in most rows$"
            with pytest.raises(Refused, match=said):
                ticks(tmp_path / "log.parquet", config, columns)


@pytest.mark.parametrize("form", ["{:.2f} sec", "00:00:{:05.2f}", "02-Feb-2026 10:00:{:05.2f}"])
def test_times_in_other_words_are_refused_in_one_sentence(form, table, signals, config, tmp_path):
    path, columns = tmp_path / "log.csv", mapping(tmp_path, signals)
    table.assign(t=[form.format(time) for time in SECONDS]).to_csv(path, index=False)
    with pytest.raises(
        Refused, match=r"^column t in line 2 of `[^`]*` is .*; expected a number, or nothing, or ISO 8601$"
    ):
        ticks(path, config, columns)
    table.assign(t=[*SECONDS[:10], "later", *SECONDS[11:]]).to_csv(path, index=False)
    with pytest.raises(
        Refused, match=r"^column t in line 12 of `[^`]*` is later; expected a number, or nothing, or ISO"
    ):
        ticks(path, config, columns)


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize(
    ("unit", "scale", "likely"),
    [(1.0, 1e-3, "s"), (1e3, 1.0, "ms"), (1e6, 1e-9, "us"), (1e6, 1e-8, "us"), (1e9, 1e-6, "ns"), (1e9, 1e-3, "ns")],
)
def test_another_unit_of_time_is_refused_with_the_likely_one(
    form, unit, scale, likely, table, signals, config, tmp_path, capsys
):
    path, columns = tmp_path / f"log.{form}", mapping(tmp_path, signals, f'columns = "t", scale = {scale}')
    getattr(table.assign(t=1e3 + SECONDS * unit), f"to_{form}")(path, index=False)
    with pytest.raises(Refused, match=rf"expected .*\(times in {likely}\?\)"):
        ticks(path, config, columns)
    for command in (("replay", path), ("export", path, "--csv", "--out", tmp_path / "out.csv")):
        words = [*command, "--experiment", EXPERIMENT, "--map", columns]
        assert commands.main([str(word) for word in words]) == 2, command
        assert f"(times in {likely}?)" in capsys.readouterr().err
    mapping(tmp_path, signals, f'columns = "t", scale = {1.0 / unit}')
    check(ticks(path, config, columns))


def test_a_log_of_few_ticks_is_refused_and_a_fast_one_is_not(table, signals, config, tmp_path):
    path, columns = tmp_path / "log.csv", mapping(tmp_path, signals)
    table.assign(t=SECONDS)[:9].to_csv(path, index=False)
    with pytest.raises(Refused, match=r"log.csv. has 9 ticks of 0\.01 s, .*; expected at least 10 ticks$"):
        ticks(path, config, columns)
    fast = table.loc[table.index.repeat(25)].assign(t=4e-4 * np.arange(25 * ROWS))
    fast.to_csv(path, index=False)
    assert ticks(path, config, columns).signals["time"].size == ROWS


def test_the_row_whose_time_is_corrupt_is_named(table, signals, config, tmp_path):
    """Not the sound one after it."""
    path, columns = tmp_path / "log.csv", mapping(tmp_path, signals)
    for row, time in ((9, 9000.0), (9, 0.115), (9, -5.0), (0, 1.7e9), (ROWS - 1, -1.0), (ROWS - 1, 1e4), (20, 30.0)):
        times = SECONDS.copy()
        times[row] = time
        table.assign(t=times).to_csv(path, index=False)
        with pytest.raises(Refused, match=rf"^row {row + 1} of .*; expected "):
            ticks(path, config, columns)


# --- stamps of messages

NOON = 1_770_000_000_000_000_000
"""A whole second since 1970 [ns]."""


def write_messages(path, table, stamp, start=None, spoil=bytes):
    """Write a topic in JSON whose messages state a time; those of recording jitter."""
    writer = pytest.importorskip("mcap.writer", reason="mcap is not installed: make setup")
    with path.open("wb") as file:
        log = writer.Writer(file)
        log.start()
        channel = log.register_channel("/a/base", "json", 0)
        for number, row in enumerate(table.to_dict("records")):
            ns = MOMENTS[number].value if start is None else start + 10_000_000 * number
            text = json.dumps(row | {"header": {"stamp": stamp(ns)}}).encode()
            log.add_message(channel, ns + 3_000_000 * (number % 2), spoil(text), 0)
        log.finish()


def messages_of(signals):
    return {name: [f"/a/base/{column}" for column in columns] for name, columns in signals.items()}


def without_zeros(stamp):
    return {unit: number for unit, number in stamp.items() if number}


def quoted(stamp):
    """How a message without time is quoted."""
    return re.escape("none" if stamp is None else repr(stamp))


@pytest.mark.close_to_tolerance("a stamp in seconds since 1970 is rounded when it is made, read and subtracted")
@pytest.mark.parametrize(
    "stamp",
    [
        lambda ns: {"sec": ns // 10**9, "nanosec": ns % 10**9},
        lambda ns: {"sec": ns // 10**9, "nsec": ns % 10**9},
        lambda ns: {"secs": ns // 10**9, "nsecs": ns % 10**9},
        lambda ns: {"seconds": ns // 10**9, "nanos": ns % 10**9},
        lambda ns: f"{pd.Timestamp(ns, tz='UTC').isoformat()}",
        lambda ns: f"{pd.Timestamp(ns).isoformat()}Z",
        lambda ns: ns * 1e-9,
    ],
)
def test_stamps_have_the_forms_of_their_programs(stamp, table, signals, config, tmp_path):
    path = tmp_path / "log.mcap"
    columns = mapping(tmp_path, messages_of(signals), 'columns = ["/a/base/header/stamp"]')
    write_messages(path, table, stamp)
    found = ticks(path, config, columns)
    # Four units in the last place of seconds since 1970.
    atol = 4.0 * np.spacing(MOMENTS[0].timestamp()) if isinstance(stamp(0), float) else 1e-9
    np.testing.assert_allclose(found.signals["time"], SECONDS, atol=atol)
    for wrong in ({"s": 1, "ns": 2}, "noon", "today", None, {"sec": 1, "usec": 2}, True, [1, 2]):
        write_messages(path, table, lambda _, wrong=wrong: wrong)
        said = (
            rf"40 of 40 messages of `/a/base` in .* state no time, the first of them message 1, with {quoted(wrong)}; "
        )
        with pytest.raises(Refused, match=rf"{said}expected a number, sec with nanosec, .*, or a text of ISO 8601"):
            ticks(path, config, columns)


MESSAGES = 'columns = ["/a/base/header/stamp"]'


@pytest.mark.parametrize(
    "stamp",
    [
        lambda ns: without_zeros({"seconds": ns // 10**9, "nanos": ns % 10**9}),
        lambda ns: without_zeros({"sec": ns // 10**9, "nanosec": ns % 10**9}),
        lambda ns: without_zeros({"secs": (ns - NOON) // 10**9, "nsecs": (ns - NOON) % 10**9}),
        lambda ns: {"seconds": str(ns // 10**9), "nanos": ns % 10**9},
        lambda ns: {"sec": ns // 10**9, "nsec": ns % 10**9, "frame": "base"},
    ],
    ids=["proto3", "ros2", "since boot", "64-bit as text", "with more"],
)
def test_what_protocol_buffers_leave_out_of_a_stamp_is_zero(stamp, table, signals, config, tmp_path):
    """Nanoseconds of a whole second, and both at the time of boot; integers of 64 bits are texts."""
    path, columns = tmp_path / "log.mcap", mapping(tmp_path, messages_of(signals), MESSAGES)
    write_messages(path, table, stamp, start=NOON)
    check(ticks(path, config, columns))


def test_nanoseconds_as_text_have_the_scale(table, signals, config, tmp_path):
    path = tmp_path / "log.mcap"
    write_messages(path, table, str)
    check(ticks(path, config, mapping(tmp_path, messages_of(signals), f"{MESSAGES}, scale = 1e-9")))


@pytest.mark.parametrize("without", [(0,), (0, 1), (20,), (5, 39)])
def test_messages_that_state_no_time_are_counted(without, table, signals, config, tmp_path):
    """The first ones too, without which the mission begins later."""
    path, columns = tmp_path / "log.mcap", mapping(tmp_path, messages_of(signals), MESSAGES)
    moments = [moment.value for moment in MOMENTS]
    write_messages(path, table, lambda ns: None if moments.index(ns) in without else {"sec": 0, "nsec": ns})
    said = rf"{len(without)} of 40 messages of `/a/base` in .* state no time, .* message {without[0] + 1}, with none; "
    with pytest.warns(UserWarning, match=f"{said}they are left out"):
        log = logs.read(path, config, columns)
    assert log.signals["raw_base_position"][0].times.size == ROWS - len(without)


@pytest.mark.parametrize(("unit", "likely"), [(1, "ns"), (1e3, "us"), (1e6, "ms")])
def test_a_stamp_of_another_unit_is_no_damage(unit, likely, table, signals, config, tmp_path):
    path, columns = tmp_path / "log.mcap", mapping(tmp_path, messages_of(signals), MESSAGES)
    write_messages(path, table, lambda ns: int(ns / unit))
    with pytest.raises(
        Refused, match=rf"^row 2 of .*expected .*\(times in {likely}\?\)|^`.*log.mcap` has 40 rows .*{likely}"
    ):
        ticks(path, config, columns)


@pytest.mark.parametrize("number", [1, 21, 40])
@pytest.mark.parametrize("wrong", [0.0, 1e200, -1e12, 1.9e9])
def test_the_message_of_one_wrong_stamp_is_named(wrong, number, table, signals, config, tmp_path):
    path, columns = tmp_path / "log.mcap", mapping(tmp_path, messages_of(signals), MESSAGES)
    moments = [moment.value for moment in MOMENTS]
    write_messages(path, table, lambda ns: wrong if moments.index(ns) == number - 1 else 1e-9 * ns)
    with pytest.raises(
        Refused, match=rf"^message {number} of `/a/base` in .*log\.mcap` states a time .* s from those of"
    ):
        ticks(path, config, columns)


@pytest.mark.parametrize("wrong", [float("inf"), float("nan"), 1e300])
def test_a_stamp_that_is_no_number_is_none(wrong, table, signals, config, tmp_path):
    path, columns = tmp_path / "log.mcap", mapping(tmp_path, messages_of(signals), MESSAGES)
    write_messages(path, table, lambda ns: wrong if ns == MOMENTS[9].value else 1e-9 * ns)
    with pytest.warns(UserWarning, match=rf"1 of 40 messages of .* message 10, with {wrong!r}".replace("+", r"\+")):
        logs.read(path, config, columns)


def test_a_message_that_is_no_json_is_named(table, signals, config, tmp_path):
    """No program for damaged files mends it; NaN of Python's writer is a missing number."""
    path, columns = tmp_path / "log.mcap", mapping(tmp_path, messages_of(signals), MESSAGES)
    write_messages(path, table, lambda ns: 1e-9 * ns, spoil=lambda text: text.replace(b'"wx": 0.0', b'"wx": NaN'))
    assert np.isnan(ticks(path, config, columns).signals["raw_wind"][:, 0]).all()
    write_messages(path, table, lambda ns: 1e-9 * ns, spoil=lambda text: text[:-1])
    with pytest.raises(Refused, match=r"^message 1 of `/a/base` in .*log\.mcap` is no JSON \("):
        ticks(path, config, columns)


# --- rotations of few digits


def tilted(table):
    """The same robot turned by up to 1 rad about an axis, as rotation matrices, and the mapping's columns of these."""
    turns = Rotation.from_rotvec(np.linspace(0.0, 1.0, ROWS)[:, None] * [0.48, -0.6, 0.64]).as_matrix()
    columns = [f"R{place}" for place in range(9)]
    return table.drop(columns=["qw", "qx", "qy", "qz"]).assign(t=SECONDS), columns, turns


def turned_columns(signals, columns):
    return {name: names for name, names in signals.items() if "quaternion" not in name} | {"raw_base_rotation": columns}


@pytest.mark.parametrize("decimals", [2, 3, 4, 5, 6, 9])
def test_a_matrix_of_few_digits_is_the_nearest_rotation(decimals, table, signals, config, tmp_path):
    """Every reader's, to all digits; each entry is within the rounding of the nine."""
    log, columns, turns = tilted(table)
    path, rounded = tmp_path / "log.csv", turns.round(decimals).reshape(ROWS, 9)
    log.assign(**dict(zip(columns, rounded.T, strict=True))).to_csv(path, index=False)
    columns = mapping(tmp_path, turned_columns(signals, columns))
    found = ticks(path, config, columns).signals["raw_base_rotation"]
    np.testing.assert_allclose(np.swapaxes(found, 1, 2) @ found, np.tile(np.eye(3), (ROWS, 1, 1)), atol=1e-14)
    assert np.abs(found - turns).max() <= 1.5 * 10.0**-decimals  # a matrix of nine roundings of half a digit
    viewed = measured.read_flight(path, config, columns, None).signals["base_quaternion"]
    np.testing.assert_allclose(rust.rotation_from_wxyz(viewed), found, atol=1e-14)
    read = logs.read(path, config, columns)
    np.testing.assert_array_equal(measured.of_controller(read, config, path).signals["raw_base_rotation"], found)


def test_a_rotation_of_all_digits_keeps_its_bits(table, signals, config, tmp_path):
    log, columns, turns = tilted(table)
    path = tmp_path / "log.parquet"
    log.assign(**dict(zip(columns, turns.reshape(ROWS, 9).T, strict=True))).to_parquet(path)
    found = ticks(path, config, mapping(tmp_path, turned_columns(signals, columns))).signals
    np.testing.assert_array_equal(found["raw_base_rotation"], turns)


def test_wrenches_of_a_simulated_world_are_not_taken_for_measured_ones(table, signals, config, tmp_path):
    """A map that named them for a replay names `raw_foot_wrench` today."""
    path = tmp_path / "log.csv"
    table.assign(t=SECONDS).to_csv(path, index=False)
    read = logs.read(path, config, mapping(tmp_path, signals))
    assert measured.of_controller(read, config, path).is_recorded.all()
    wrong = read._replace(signals={**read.signals, "foot_wrench": read.signals["raw_wind"]})
    with pytest.raises(Refused, match=r"has `foot_wrench`, .*; expected `raw_foot_wrench`"):
        measured.of_controller(wrong, config, path)


@pytest.mark.parametrize("factor", [0.0, 2.0, 1.02, -1.0])
@pytest.mark.parametrize("command", ["replay", "identify", "export"])
def test_what_is_no_rotation_is_refused_with_its_row(command, factor, table, signals, config, tmp_path, capsys):
    """Zeros before the first message, another scale, and a reflection: by every reader, also in few of the rows."""
    log, columns, turns = tilted(table)
    path, rows = tmp_path / "log.csv", turns.reshape(ROWS, 9).copy()
    rows[30:33] *= factor
    log.assign(**dict(zip(columns, rows.T, strict=True))).to_csv(path, index=False)
    words = [command, path, "--experiment", EXPERIMENT, "--map", mapping(tmp_path, turned_columns(signals, columns))]
    words += ["--csv", "--out", tmp_path / "out.csv"] if command == "export" else []
    assert commands.main([str(word) for word in words]) == 2
    said = capsys.readouterr().err
    assert "in row 31 at 0.3 s, and no rotation in 3 ticks; expected one, or nothing where it is not measured" in said
    rows[30:33] = np.nan
    log.assign(**dict(zip(columns, rows.T, strict=True))).to_csv(path, index=False)
    found = ticks(path, config, words[5]).signals["raw_base_rotation"]
    assert np.flatnonzero(np.isnan(found).any(axis=(1, 2))).tolist() == [30, 31, 32]


# --- what tables of others hold


@pytest.mark.parametrize("name", ["LOG0001.CSV", "log.tsv", "log.Txt", "LOG.PARQUET"])
def test_suffixes_are_those_of_others(name, table, signals, config, tmp_path):
    path = tmp_path / name
    log = table.assign(t=SECONDS)
    if path.suffix.lower() == ".parquet":
        log.to_parquet(path)
    else:
        log.to_csv(path, index=False, sep={".csv": ",", ".tsv": "\t", ".txt": " "}[path.suffix.lower()])
    check(ticks(path, config, mapping(tmp_path, signals)))


def test_numpys_tables_have_their_header_in_a_comment(table, signals, config, tmp_path):
    path, log = tmp_path / "log.txt", table.assign(t=SECONDS)
    for separator, title in ((" ", ""), (",", ""), ("\t", "of a rig\n")):
        np.savetxt(path, log.to_numpy(), delimiter=separator, header=title + separator.join(log))
        check(ticks(path, config, mapping(tmp_path, signals)))


@pytest.mark.parametrize("comment", ["# ", "% ", "%", "%% of a rig\n% "])
def test_a_header_may_be_a_comment_of_either_kind(comment, table, signals, config, tmp_path):
    """As NumPy's users and MATLAB's write it."""
    path, log = tmp_path / "log.txt", table.assign(t=SECONDS)
    np.savetxt(path, log.to_numpy(), delimiter=",", header=",".join(log), comments=comment)
    check(ticks(path, config, mapping(tmp_path, signals)))


@pytest.mark.parametrize(("word", "number"), [("1.#INF", np.inf), ("-1.#INF", -np.inf), ("1.#INF00", np.inf)])
def test_infinity_of_microsofts_library_is_a_number(word, number, table, signals, config, tmp_path):
    path, log = tmp_path / "log.csv", table.assign(t=SECONDS).astype(object)
    log.loc[[3, 4], "wx"] = word
    log.to_csv(path, index=False)
    wind = logs.read(path, config, mapping(tmp_path, signals)).signals["raw_wind"][0].rows
    assert wind[3:5].tolist() == [number, number]


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])
def test_tables_and_maps_of_windows_have_a_mark(encoding, table, signals, config, tmp_path):
    path, columns = tmp_path / "log.csv", mapping(tmp_path, signals)
    table.assign(t=SECONDS).to_csv(path, index=False, encoding=encoding)
    columns.write_text(columns.read_text(), encoding=encoding)
    check(ticks(path, config, columns))


@pytest.mark.parametrize("word", ["-nan(ind)", "1.#QNAN0", "-1.#IND00", "1.#QNAN", "#N/A", "NaN", "", "<NA>"])
def test_missing_numbers_of_other_programs_are_none(word, table, signals, config, tmp_path):
    path, log = tmp_path / "log.csv", table.assign(t=SECONDS).astype(object)
    log.loc[[3, 4], ["wx", "wy", "wz"]] = word
    log.to_csv(path, index=False)
    wind = ticks(path, config, mapping(tmp_path, signals)).signals["raw_wind"]
    assert np.flatnonzero(np.isnan(wind).any(axis=1)).tolist() == [3, 4]


def test_a_text_that_means_missing_is_declared(table, signals, config, tmp_path):
    path, log = tmp_path / "log.csv", table.assign(t=SECONDS).astype(object)
    log.loc[[3, 4], "wx"] = "OFF"
    log.loc[5, "wx"] = 99.0
    log.to_csv(path, index=False)
    with pytest.raises(Refused, match=r"column wx in line 5 of .* is OFF; expected a number, or nothing"):
        ticks(path, config, mapping(tmp_path, signals, raw_wind="missing = [99.0]"))
    wind = ticks(path, config, mapping(tmp_path, signals, raw_wind='missing = ["OFF", 99.0]')).signals["raw_wind"]
    assert np.flatnonzero(np.isnan(wind).any(axis=1)).tolist() == [3, 4, 5]
    log.loc[7, "z"] = "OFF"  # which it does not mean in another column
    log.to_csv(path, index=False)
    with pytest.raises(Refused, match=r"column z in line 9 of .* is OFF"):
        ticks(path, config, mapping(tmp_path, signals, raw_wind='missing = ["OFF", 99.0]'))


@pytest.mark.parametrize("form", ["[{0}, {1}, {2}]", "({0};{1};{2})", "{{{0} {1} {2}}}"])
def test_a_cell_of_several_numbers_says_what_is_read(form, table, signals, config, tmp_path):
    path = tmp_path / "log.csv"
    cells = [form.format(x, y, z) for x, y, z in table[["x", "y", "z"]].itertuples(index=False)]
    table.assign(t=SECONDS, x=cells).to_csv(path, index=False)
    with pytest.raises(Refused, match=r"column x in line 2 of .* expected a number, or nothing, each in a column"):
        ticks(path, config, mapping(tmp_path, signals))


@pytest.mark.parametrize(
    ("name", "way"),
    [
        ("flight.ulg", "ulog2csv"),
        ("00000012.BIN", "mavlogdump"),
        ("a.bag", "PlotJuggler"),
        ("a_0.db3", "ros2 bag convert"),
        ("a.csv.gz", "unpack"),
        ("log.xlsx", "save its sheet as CSV"),
        ("00001.MF4", "asammdf"),
        ("run.h5", "parquet"),
        ("a.foo", "or a file of .mcap"),
    ],
)
def test_formats_that_are_not_read_say_what_makes_one_that_is(name, way, signals, tmp_path, capsys):
    path = tmp_path / name
    path.touch()
    for words in (
        ("replay", path),
        ("replay", path, "--map", mapping(tmp_path, signals), "--experiment", EXPERIMENT),
        ("export", path, "--csv", "--out", tmp_path / "a.csv"),
    ):
        assert commands.main([str(word) for word in words]) == 2
        err = capsys.readouterr().err
        assert ".mcap, .mat, .csv, .tsv, .txt, .parquet" in err
        assert "damaged" not in err
        if way[:2] != "or":
            assert way in err
