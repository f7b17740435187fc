"""What someone types who has arrays or a data frame and never saw dynid: it works, or one line says what to type."""

from __future__ import annotations

import inspect
import sys

import numpy as np
import pytest
from each import each

import dynid

TIME = np.arange(400) / 100.0
POSITION = 0.8 * np.sin(np.outer(TIME, np.linspace(1, 2, 6)))
JOINTS = dynid.load_robot("ur5e").robot.joint_names


def frame(**more):
    pandas = pytest.importorskip("pandas")
    columns = {"time": TIME}
    for joint in range(6):
        columns[f"q{joint + 1}"] = POSITION[:, joint]
        columns[f"torque{joint + 1}"] = 3 * POSITION[:, joint]
    return pandas.DataFrame({**columns, **more})


def named(**more):
    return {"t": TIME, "q": POSITION, "torque": 3 * POSITION, **more}


def in_degrees(data):
    for joint in range(6):
        data[f"q{joint + 1}"] = np.rad2deg(data[f"q{joint + 1}"])
    return data


def with_gap(data):
    data.loc[7, "q1"] = np.nan
    return data


def unnamed(data):
    order = ["time", *(f"q{k}" for k in range(1, 7)), *(f"torque{k}" for k in range(1, 7))]
    return type(data)(data[order].to_numpy())


FRAMES = {
    "as it is": lambda data: (data, {}),
    "time as index": lambda data: (data.set_index("time"), {}),
    "dates": lambda data: (data.assign(time=np.datetime64("2026-01-01") + (1e9 * TIME).astype("timedelta64[ns]")), {}),
    "durations as index": lambda data: (
        data.set_index((1e9 * TIME).astype("timedelta64[ns]")).drop(columns="time"),
        {},
    ),
    "rate": lambda data: (data.drop(columns="time"), {"rate": 100.0}),
    "milliseconds, integers": lambda data: (data.assign(time=np.rint(1000 * TIME).astype(int)), {"time_unit": "ms"}),
    "degrees": lambda data: (in_degrees(data), {"degrees": True}),
    "degrees as a unit": lambda data: (in_degrees(data), {"units": {"position": "deg"}}),
    "units in names": lambda data: (in_degrees(data).rename(columns={f"q{k}": f"q{k} [deg]" for k in range(1, 7)}), {}),
    "joints' names": lambda data: (
        data.rename(columns={f"q{k + 1}": f"position_{name}" for k, name in enumerate(JOINTS)}),
        {},
    ),
    "names of their own": lambda data: (
        data.rename(columns={f"q{k}": f"enc{k}" for k in range(1, 7)}),
        {"columns": {"q": "enc{}"}},
    ),
    "unnamed": lambda data: (unnamed(data), {"columns": {"t": "1", "q": "2-7", "torque": "8-13"}}),
    "a gap": lambda data: (with_gap(data), {"repair": ["drop-nan"]}),
    "nullable numbers": lambda data: (data.convert_dtypes(), {}),
}
"""Data frames, with what to type beside them."""


@each("name", FRAMES)
def test_a_data_frame_becomes_a_recording(name):
    data, options = FRAMES[name](frame())
    run = dynid.Recording.from_dataframe("ur5e", data, **options)
    kept = np.delete(np.arange(400), 7) if name == "a gap" else np.arange(400)
    np.testing.assert_allclose(run.time - run.time[0], TIME[kept], atol=1e-9)
    np.testing.assert_allclose(run.position, POSITION[kept], atol=1e-12)
    np.testing.assert_allclose(run.torque, 3 * POSITION[kept], atol=1e-12)


REFUSED_FRAMES = {
    "no time": (lambda data: data.drop(columns="time"), r"has no time \(give the sampling rate: rate=HZ, or map a col"),
    "unnamed": (lambda data: unnamed(data), r'name them t, q1, .* or number them: columns=\{"t": "1", "q": "2-7"'),
    "degrees": (in_degrees, r"degrees=True"),
    "a gap": (lambda data: with_gap(data), r"repair=\['drop-nan'\]"),
    "a joint short": (lambda data: data.drop(columns="q3"), r"5 columns of position, but the robot has 6 joints"),
    "texts": (lambda data: data.assign(q1="a"), "q1: .*numbers"),
    "an array": (lambda data: data.to_numpy(), "is not a data frame .*Recording.from_arrays"),
    "a dictionary": (lambda data: named(), "is not a data frame .*Recording.from_dict"),
}


@each("name", REFUSED_FRAMES)
def test_a_data_frame_that_is_refused_says_what_to_type(name):
    change, message = REFUSED_FRAMES[name]
    with pytest.raises(dynid.DynidError, match=message) as refused:
        dynid.Recording.from_dataframe("ur5e", change(frame()))
    assert "--" not in str(refused.value)


def test_a_dictionary_of_lists_becomes_a_recording():
    given = {name: values.tolist() for name, values in named().items()}
    run = dynid.Recording.from_dict("ur5e", given)
    np.testing.assert_array_equal(run.position, POSITION)
    deg = dynid.Recording.from_dict("ur5e", named(q=np.rad2deg(POSITION)), units={"q": "deg"})
    np.testing.assert_allclose(deg.position, POSITION, atol=1e-12)
    with pytest.raises(dynid.UsageError, match="neither a column nor a quantity"):
        dynid.Recording.from_dict("ur5e", named(), units={"pose": "deg"})
    with pytest.raises(dynid.ImportFileError, match="q: does not consist of numbers in equal rows"):
        dynid.Recording.from_dict("ur5e", named(q=[[1.0], [1.0, 2.0]]))


class Tensor:
    """A tensor with a gradient, as torch has it."""

    def __array__(self, *_, **__):
        raise RuntimeError("Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy() instead.")


def test_a_tensor_with_a_gradient_says_what_torch_says(result):
    for refused in (
        lambda: dynid.Recording.from_arrays("ur5e", time=TIME, position=Tensor(), torque=POSITION),
        lambda: dynid.Recording.from_dict("ur5e", named(q=Tensor())),
        lambda: result.model.torque(Tensor()),
    ):
        with pytest.raises(dynid.InputError, match=r"numbers.*detach\(\)"):
            refused()


@each(
    ("given", "door"),
    [
        (lambda: frame(), "from_dataframe"),
        (named, "from_dict"),
        (lambda: POSITION, "from_arrays"),
        (lambda: (TIME, POSITION), "from_arrays"),
        (lambda: None, "from_arrays"),
    ],
)
def test_what_is_no_recording_is_told_its_door(given, door):
    for task in (dynid.identify, dynid.info):
        with pytest.raises(dynid.UsageError, match=f"is not a recording.*Recording.{door}"):
            task(given())


def test_a_foreign_file_is_told_its_door(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,q1\n0,0\n")
    with pytest.raises(dynid.RecordingError, match=r"dynid.import_recording\("):
        dynid.identify(path)


def test_options_are_named_as_python_types_them(run):
    with pytest.raises(dynid.UsageError, match="split 1000 s is outside the data"):
        dynid.identify(run, split=1000.0)
    with pytest.raises(dynid.UsageError, match="split and validation exclude each other"):
        dynid.identify(run, split=3.0, validation=run)
    with pytest.raises(TypeError, match=r"identify\(\) has no argument 'validate': did you mean 'validation'"):
        dynid.identify(run, validate=run)


def test_a_recording_shows_itself_in_a_line(run):
    assert repr(run) == str(run) == "<dynid.Recording of ur5e: 10 s at 100 Hz, position, current>"
    assert "current [A]" in run._repr_html_()
    for shown in (run.streams["joints"], run.streams["joints"].channels["current"], run.robot(), dynid.info(run)):
        assert len(repr(shown).splitlines()) == 1
    with pytest.raises(dynid.DataError, match=r"velocity was not recorded \(recorded: .*numpy.gradient"):
        _ = run.velocity
    with pytest.raises(dynid.DataError, match=r"torque was not recorded .*dynid.identify turns currents into torques"):
        _ = run.torque


def test_results_show_themselves_in_a_line(result, run):
    shown = (result, result.model, result.parameters, result.verdict, dynid.predict(result, run))
    assert [one for one in map(repr, shown) if not one.startswith("<dynid.") or "\n" in one] == []


def test_score_is_that_of_regressors(result, other):
    assert 0.99 < result.score(other) < 1.0
    opposite = dynid.Recording.from_arrays("ur5e", time=other.time, position=other.position, current=-other.current)
    assert result.score(opposite) < 0.0


def test_a_frame_of_a_recording_reads_back(run):
    pytest.importorskip("pandas")
    again = dynid.Recording.from_dataframe(run.robot(), run.to_frame())
    np.testing.assert_array_equal(again.position, run.position)
    np.testing.assert_array_equal(again.current, run.current)


def test_plots_are_of_plotly_and_of_matplotlib(result, run, monkeypatch):
    prediction = dynid.predict(result, run)
    plots = (run.plot, result.plot, prediction.plot, result.model.friction_curve)
    for plot in plots:
        figure = plot()
        assert len(figure.data) >= 6
        assert all(np.asarray(trace.y).dtype.kind == "f" for trace in figure.data)
    assert len({(line.line.color, line.line.dash) for line in run.plot("position").data}) == 6
    with pytest.raises(dynid.UsageError, match=r'no backend .*backend="matplotlib"'):
        run.plot(backend="gnuplot")
    with pytest.raises(dynid.DataError, match="torque was not recorded"):
        run.plot("torque")
    with pytest.raises(dynid.UsageError, match=r"dynid.predict\(result, run\).plot\(\)"):
        dynid.IdentificationResult(result.result).plot()
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(dynid.UsageError, match="pip install matplotlib"):
        run.plot(backend="matplotlib")


def test_matplotlib_draws_the_same_lines(result, run):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    for plot in (run.plot, result.model.friction_curve):
        figure, reference = plot(backend="matplotlib"), plot()
        lines = [line for axes in figure.axes for line in axes.lines]
        assert len(lines) == len(reference.data)
        np.testing.assert_array_equal(lines[0].get_ydata(), reference.data[0].y)
        matplotlib.pyplot.close(figure)


def test_what_holds_the_arm_still_needs_positions_alone(result):
    model, q = result.model, np.full(6, 0.3)
    zero = np.zeros(6)
    np.testing.assert_array_equal(model.torque(q), model.torque(q, zero, zero))
    many = np.tile(q, (3, 1))
    np.testing.assert_allclose(model.torque(many, 0.1 * q), model.torque(many, 0.1 * many, 0 * many), atol=1e-12)
    np.testing.assert_array_equal(model.torque(q, 0.1 * many), model.torque(many, 0.1 * many))
    parts = model.torque_parts(q, None, 0.1 * many)
    np.testing.assert_allclose(sum(parts.values()), model.torque(q, None, 0.1 * many), atol=1e-12)
    assert {part.shape for part in parts.values()} == {(3, 6)}
    assert model.regressor(q).shape[0] == 6
    assert model.torque_std(many).shape == (3, 6)


def test_nothing_is_overwritten_unasked(result, run, tmp_path):
    path = tmp_path / "run.h5"
    run.save(path)
    np.testing.assert_array_equal(dynid.read_recording(path).position, run.position)
    result.save(tmp_path / "model")
    result.model.export_urdf(tmp_path / "arm.urdf")
    for write in (
        lambda **more: run.save(path, **more),
        lambda **more: dynid.write_recording(path, run, **more),
        lambda **more: result.save(tmp_path / "model", **more),
        lambda **more: result.model.export_urdf(tmp_path / "arm.urdf", **more),
    ):
        with pytest.raises(dynid.UsageError, match=r"exists already .*overwrite=True"):
            write()
        write(overwrite=True)


def test_help_is_a_screen():
    import pydoc

    assert len(pydoc.render_doc(dynid).splitlines()) <= 40


def test_what_numbers_alone_do_not_show_is_refused():
    pandas = pytest.importorskip("pandas")
    masked = np.ma.masked_greater(POSITION, 0.7)
    swapped = pandas.DataFrame(POSITION, columns=JOINTS[::-1])
    for position, words in (
        (swapped, "the joints' order is shoulder_pan_joint"),
        (masked, "have NaN or infinite values"),
        (POSITION + 0j, "holds complex numbers"),
    ):
        with pytest.raises(dynid.DataError, match=words):
            dynid.Recording.from_arrays("ur5e", time=TIME, position=position, torque=POSITION)


def test_what_is_no_path_is_said():
    for call in (
        lambda: dynid.load_model(None),
        lambda: dynid.load_result(3),
        lambda: dynid.read_recording(None),
        lambda: dynid.load_trajectory(3, "ur5e"),
        lambda: dynid.merge([1, 2]),
        lambda: dynid.compare(None, methods=None),
        lambda: dynid.simulate("ur5e", duration="5"),
    ):
        with pytest.raises(dynid.UsageError):
            call()


class Odd:
    """Nothing that any function takes."""


WRONG = (None, 3, "", "no\0such", b"x", [], [None], {}, np.zeros((3, 2)), Odd())
NEEDED = {"runs": "run", "run": "run", "robot": "ur5e", "free": "run", "loaded": "run", "recording": "run"}
"""Arguments that must be right for the others to be looked at; what any other needs names no file."""


def in_one_line(call):
    try:
        call()
    except dynid.DynidError as error:
        return "" if "\n" not in str(error) and len(str(error)) < 600 else f"{error!r}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "taken"


def test_any_wrong_argument_is_refused_in_one_line(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    run = dynid.Recording.from_dict("ur5e", named())
    functions = [name for name in dir(dynid) if inspect.isfunction(getattr(dynid, name))]
    said = {}
    for name in functions:
        function, parameters = getattr(dynid, name), inspect.signature(getattr(dynid, name)).parameters
        needed = [key for key, one in parameters.items() if one.default is inspect.Parameter.empty]
        for value in (*WRONG, frame()) if needed else ():
            said[name, type(value).__name__] = in_one_line(lambda: function(*[value] * len(needed)))  # noqa: B023
        given = [{"run": run}.get(NEEDED.get(key, ""), NEEDED.get(key, "nowhere")) for key in needed]
        for key in set(parameters) - set(needed) - {"overwrite", "progress"}:
            for value in (Odd(), [Odd()]):
                said[name, key, type(value).__name__] = in_one_line(lambda: function(*given, **{key: value}))  # noqa: B023
    assert {call: words for call, words in said.items() if words} == {}


def test_what_is_saved_needs_a_path(run, result, tmp_path):
    saved = {
        run.save, result.save, result.model.export_urdf, result.model.export_mjcf, result.model.export_c,
        result.model.export_ros2_inertial, dynid.predict(result, run).save, dynid.predict(result, run).page,
        dynid.info(run).save,
    }  # fmt: skip
    bare = [
        kind.save.__get__(object.__new__(kind))
        for kind in (dynid.IdentifiedFriction, dynid.IdentifiedGains, dynid.IdentifiedPayload, dynid.IdentifiedGravity)
    ]
    for save in (*saved, *bare):
        for value in (None, 3, [], frame(), Odd()):
            assert in_one_line(lambda: save(value)) == "", save  # noqa: B023
    for call, words in (
        (lambda: dynid.import_recording(frame(), "ur5e"), "a DataFrame is not a path .*from_dataframe"),
        (lambda: dynid.merge(None), "None is not a list of results"),
        (lambda: dynid.write_recording(tmp_path / "x.h5", None), "None is not a recording"),
        (lambda: dynid.identify(run, gravity=True), r"has no argument 'gravity': dynid.identify_gravity\(runs\)"),
        (lambda: dynid.identify(), r"identify\(\): missing a required argument: 'runs'"),
    ):
        with pytest.raises(dynid.UsageError, match=words):
            call()
    with pytest.raises(TypeError):
        dynid.identify()
