"""`smallwheel fit`, `diagnose` and `add`: thin shells over fitting and diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from smallwheel_ros.commands.inputs import check_column, limits, read_inputs, warn, without_ids
from smallwheel_ros.diagnosis.apply import Added, add_effect
from smallwheel_ros.diagnosis.pipeline import Diagnosis
from smallwheel_ros.diagnosis.pipeline import diagnose as diagnose_data
from smallwheel_ros.diagnosis.text import diagnosis_text
from smallwheel_ros.display import number, shown_value, words
from smallwheel_ros.effects.registry import default_registry, load_effects
from smallwheel_ros.errors import SmallwheelError
from smallwheel_ros.fitting import Base, FitResult, Problem
from smallwheel_ros.fitting.files import calibrated
from smallwheel_ros.fitting.parameters import part_of
from smallwheel_ros.measurements.table import read_measurements
from smallwheel_ros.model import Geometry
from smallwheel_ros.model_file import write_model
from smallwheel_ros.output import check_folder_target, check_targets
from smallwheel_ros.tables import write_json

_DATA = click.argument("data", type=click.Path(path_type=Path))
_DIAMETER = click.option("--diameter", type=float, help="Wheel diameter [m] for all rows.")
_WIDTH = click.option("--width", type=float, help="Wheel width [m] for all rows.")
_JSON = click.option("--json", "json_file", metavar="FILE",
                     help="Write the result as JSON, - for standard output.")  # fmt: skip
_OWN = click.option("--effects", "own", type=click.Path(path_type=Path), metavar="FILE",
                    help="A Python file with effects of your own. It is run: name only files "
                    "that you trust.")  # fmt: skip
_WITHOUT = click.option("--without", default="", metavar="ID,ID",
                        help="Effects that do not compete, by id; `unknown` for curves without a "
                        "name.")  # fmt: skip


class BenchError(SmallwheelError):
    """Options of fit, diagnose or add that do not go together."""


@click.command("fit", short_help="Calibrate soil and effects on measurements.")
@_DATA
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path),
              help="Model file to write.")  # fmt: skip
@click.option("--effects", "names", default="", metavar="A,B",
              help="Effects to fit with the soil, by id (slip_sinkage,bulldozing) or id/form; a "
              "name that ends in .py is a file with effects of your own, which is run.")  # fmt: skip
@click.option("--geometry", type=click.Choice(["contact_integral", "closed_form"]),
              default="contact_integral", show_default=True)  # fmt: skip
@_DIAMETER
@_WIDTH
@_JSON
def fit(
    data: Path,
    output: Path,
    names: str,
    geometry: str,
    diameter: float | None,
    width: float | None,
    json_file: str | None,
) -> None:
    """Calibrate soil and effects on the measurements in DATA and write a model file."""
    given = [name.strip() for name in names.split(",") if name.strip()]
    check_targets([output, json_file], [data, *(n for n in given if n.endswith(".py"))])
    measurements = read_measurements(data, diameter=diameter, width=width)
    warn(measurements)
    registry = default_registry()
    for name in given:
        if name.endswith(".py"):
            registry = registry.with_families(load_effects(name), name)
    effects = []
    for name in (n for n in given if not n.endswith(".py")):
        id, _, form = name.partition("/")
        effects.append(registry.form(id, form or None).suited_to(measurements.conditions))
    rule: Geometry = "closed_form" if geometry == "closed_form" else "contact_integral"
    base = Base(geometry=rule, parts=tuple(part_of(effect) for effect in effects))
    problem = Problem.of(measurements, base)
    result, errors = problem.result(), problem.held_out()
    held_out = {} if errors is None else errors.rmse()
    write_model(output, calibrated(result, measurements, held_out))
    if json_file is not None:
        write_json(json_file, fit_document(result) | {"held_out_rmse": held_out})
    if json_file != "-":
        click.echo(fit_text(result))
        if held_out:
            click.echo("Held-out error (runs left out of the fit)")
        for name, value in held_out.items():
            click.echo(f"  {words(name)}: {shown_value(name, value)}")
        click.echo(f"written: {output}")


def fit_document(result: FitResult) -> dict[str, Any]:
    """What a fit found, as plain values."""
    return {
        "parameters": {
            p.full_name: {
                "value": p.value,
                "std": p.std,
                "unit": p.unit,
                "status": p.status,
                "remedy": p.remedy,
            }
            for p in result.parameters
        },
        "correlation": {
            "names": list(result.names),
            "matrix": [[float(f"{v:.6g}") for v in row] for row in result.correlation],
        },
        "soils": {s.name: {"k": s.k, "n": s.n, "m": s.m} for s in result.model.soils},
        "noise": {
            name: {"absolute": n.absolute, "relative": n.relative, "source": n.source}
            for name, n in result.noise.items()
        },
        "run_scatter": dict(result.run_scatter),
        "outliers": result.outliers.tolist(),
        "notes": list(result.notes),
    }


def fit_text(result: FitResult) -> str:
    """What a fit found, in words."""
    lines = ["Fitted parameters"]
    for p in result.parameters:
        unit = "" if p.unit == "1" else f" {p.unit}"
        std = "" if p.std is None else f" +- {number(p.std)}"
        said = "" if p.status == "determined" else f"  ({p.status})"
        lines.append(f"  {p.full_name:38s} {number(p.value, 4)}{std}{unit}{said}")
    for soil in result.model.soils:
        lines.append(
            f"  {soil.name}: k = {soil.k:.4g} Pa/m^(n+m), n = {soil.n:.4g}, m = {soil.m:.4g}"
        )
    lines.append("Noise of one row")
    for name, noise in result.noise.items():
        size = f"{shown_value(name, noise.absolute)} and {100 * noise.relative:.1f} %"
        lines.append(f"  {words(name)}: {size} (from {noise.source})")
    lines += ["Notes", *[f"  {note}" for note in result.notes]] if result.notes else []
    return "\n".join(lines)


@click.command("diagnose", short_help="Find which physical effect a model is missing.")
@_DATA
@click.option("--model", "model_file", type=click.Path(path_type=Path),
              help="Start from this model file; its soil is refitted within its covariance.")  # fmt: skip
@_JSON
@click.option("--html", type=click.Path(path_type=Path), help="Write a self-contained report.")
@click.option("--plots", type=click.Path(path_type=Path), metavar="DIR",
              help="Write pictures (PNG) into this folder.")  # fmt: skip
@click.option("--apply", is_flag=True, help="Add what the verdict names; needs -o.")
@click.option("-o", "--output", type=click.Path(path_type=Path),
              help="With --apply: model file to write.")  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True,
              help="Of the simulations behind the p-values.")  # fmt: skip
@_WITHOUT
@click.option("--can", "levels", multiple=True, metavar="NAME=A..B|A,B,C",
              help="What you can set, for the measurements to make next: slip=0..0.6, "
              "load=20,40,60 (SI units, angles in rad). May be given several times.")  # fmt: skip
@_OWN
@_DIAMETER
@_WIDTH
def diagnose(
    data: Path,
    model_file: Path | None,
    json_file: str | None,
    html: Path | None,
    plots: Path | None,
    apply: bool,
    output: Path | None,
    seed: int,
    without: str,
    levels: tuple[str, ...],
    own: Path | None,
    diameter: float | None,
    width: float | None,
) -> None:
    """Say which physical effect a model of the measurements in DATA is missing.

    Or that none is, that none known explains it, that several cannot be told apart, or that the
    data is too small; where the model fails, what the data cannot show, and what to measure next.
    """
    if apply != (output is not None):
        raise BenchError("--apply and -o FILE go together: one without the other does nothing")
    check_targets([json_file, html, output], [data, own])
    check_targets([json_file, html], [model_file])  # -o may replace it
    check_folder_target(plots)
    measurements, base, registry = read_inputs(data, model_file, own, diameter, width)
    can, out = limits(levels, measurements), without_ids(without, registry)
    with tqdm(total=5, desc="diagnosing", disable=None, leave=False) as bar:

        def progress(step: str) -> None:
            bar.set_description(step)
            bar.update()

        result = diagnose_data(
            measurements,
            base,
            registry=registry,
            seed=seed,
            without=out,
            limits=can,
            progress=progress,
        )
    written = _write(result, json_file, html, plots, output)
    if json_file != "-":
        click.echo(diagnosis_text(result.document))
        if written:
            click.echo(f"written: {', '.join(str(path) for path in written)}")


def _write(
    result: Diagnosis,
    json_file: str | None,
    html: Path | None,
    plots: Path | None,
    output: Path | None,
) -> list[Path]:
    written: list[Path] = []
    if output is not None:
        last = len(result.steps) - 1
        if last < 1:
            gone = "" if last == 0 else f"; {output} was not written"
            click.echo(f"nothing was named, so nothing was added{gone}", err=True)
        if last >= 0:
            held_out = result.document["steps"][-1]["held_out_rmse"]
            write_model(output, calibrated(result.fitted(last), result.measurements, held_out))
            written.append(output)
    if html is not None or plots is not None:
        from smallwheel_ros.report.diagnosis_pictures import report_page, write_pictures

        if html is not None:
            from smallwheel_ros.report.page import write_page

            write_page(html, report_page(result))
            written.append(html)
        if plots is not None:
            written += write_pictures(result, plots)
    if json_file is not None:
        write_json(json_file, result.document)
    return written


@click.command("add", short_help="Add one effect to a model file, see whether the error falls.")
@click.argument("effect")
@click.option("--model", "model_file", required=True, type=click.Path(path_type=Path),
              help="Model file to add it to.")  # fmt: skip
@click.option("--data", required=True, type=click.Path(path_type=Path), help="Measurements.")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path),
              help="Model file to write.")  # fmt: skip
@_JSON
@_WITHOUT
@_OWN
@_DIAMETER
@_WIDTH
def add(
    effect: str,
    model_file: Path,
    data: Path,
    output: Path,
    json_file: str | None,
    without: str,
    own: Path | None,
    diameter: float | None,
    width: float | None,
) -> None:
    """Add EFFECT to a model, fit it with the soil, and print the held-out error before and after."""
    check_targets([output, json_file], [data, own])
    check_targets([json_file], [model_file])  # -o may replace it
    measurements, base, registry = read_inputs(data, model_file, own, diameter, width)
    check_column(effect, measurements, registry)
    out = without_ids(without, registry)
    result = add_effect(effect, base, measurements, registry=registry, without=out)
    after = result.after.rmse()
    write_model(output, calibrated(result.fit, measurements, after))
    if json_file is not None:
        write_json(json_file, added_document(result))
    if json_file != "-":
        click.echo(added_text(result))
        click.echo(f"written: {output}")


def added_document(result: Added) -> dict[str, Any]:
    """What adding an effect did, as plain values."""
    return {
        "effect": result.effect,
        "form": result.form,
        "recommended": result.recommended,
        "reason": result.reason,
        "before": {"held_out_rmse": result.before.rmse(), "std": result.before.rmse_std()},
        "after": {"held_out_rmse": result.after.rmse(), "std": result.after.rmse_std()},
        "reduction": dict(result.change.reduction),
        "z_score": dict(result.change.z_score),
        "fit": fit_document(result.fit),
    }


def added_text(result: Added) -> str:
    """What adding an effect did, in words."""
    lines = [f"{words(result.effect)} ({result.form}), held-out error before and after"]
    before, after = result.before.rmse(), result.after.rmse()
    for name in before:
        first = _with_error(name, before, result.before.rmse_std())
        second = _with_error(name, after, result.after.rmse_std())
        lines.append(f"  {words(name)}: {first} -> {second}")
    lines.append(result.reason or "recommended: the diagnosis of this data names it")
    lines += [f"  {p.full_name} = {number(p.value)}" + ("" if p.std is None else f" +- {number(p.std)}")
              for p in result.fit.parameters if p.owner == result.effect]  # fmt: skip
    return "\n".join(lines)


def _with_error(name: str, values: Mapping[str, float], stds: Mapping[str, float | None]) -> str:
    std = stds[name]
    return shown_value(name, values[name]) + (
        "" if std is None else f" +- {shown_value(name, std)}"
    )
