"""Commands that solve: run."""

from __future__ import annotations

import sys

import click

from contactqp.cli.output import NOT_MET, complain, console, print_json


@click.command("run")
@click.argument("cases", nargs=-1, required=True, metavar="CASE...")
@click.option("--method", "methods", multiple=True, metavar="M", help="A name of `contactqp methods`; may be repeated.")
@click.option("--penalty", metavar="BETA", help='With its unit, as in "1e8 kN/m".')
@click.option("--perturbation", metavar="KAPPA", help='With its unit, as in "1e8 kN/m".')
@click.option("--option", "options", multiple=True, metavar="KEY=VALUE", help="Any other option of the method.")
@click.option("--plot", metavar="FILE", help="Draw the structure, and its history: .png, .pdf or .svg.")
@click.option("--vtu", metavar="FILE", help="Write displacements, stresses and contacts for ParaView: .vtu.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def run_command(
    cases: tuple[str, ...],
    methods: tuple[str, ...],
    penalty: str | None,
    perturbation: str | None,
    options: tuple[str, ...],
    plot: str | None,
    vtu: str | None,
    as_json: bool,
) -> None:
    """Solve each CASE (a file, or a folder of them) and compare with what it expects.

    A CASE may also be a folder or .npz of matrices, or a problem of frictional contact in a file of FCLIB (HDF5) or
    Siconos (text): it is solved, and what is said of it is its certificate.

    Without --method: by active-set, and by every method that the case itself says something about.

    --plot and --vtu show the answer by active-set or, with --method, those of all methods named; where there are
    several, the names of case and method are put before the suffix of FILE. A load path or a motion is drawn as
    displacements, forces and energies with its events, to FILE with "history" before the suffix.
    """
    from contactqp.scene.arguments import are_case_files, case_files, read_knobs
    from contactqp.scene.judging import Failure, Judgement, judge_all
    from contactqp.scene.loading import load_scene
    from contactqp.scene.printing import judgement_data, print_judgements
    from contactqp.scene.printing_paths import print_failure

    named, foreign = list(cases), list[str]()
    if not are_case_files(cases):
        from contactqp.study.friction_files import split_files

        named, foreign = split_files(cases)
    scenes = [load_scene(file) for file in case_files(named)]
    knobs = read_knobs(penalty, perturbation, options)
    files = None
    if plot is not None or vtu is not None:
        from contactqp.study.answer_files import answer_files

        files = answer_files(scenes, plot, vtu, every_method=bool(methods))
    terminal, outcomes = console(), []
    for scene in scenes:
        outcomes += (found := judge_all(scene, methods, knobs))
        for failure in (outcome for outcome in found if isinstance(outcome, Failure)):
            complain(failure.message)
            if not as_json:
                print_failure(terminal, failure)
        if not as_json:
            print_judgements(terminal, [outcome for outcome in found if isinstance(outcome, Judgement)])
        for file in files.write(found) if files is not None else ():
            click.echo(f"written: {file}", err=as_json)
    data, met = [judgement_data(outcome) for outcome in outcomes] if as_json else [], all(o.met for o in outcomes)
    if foreign:
        from contactqp.study.friction_files import outcome_data, run_files
        from contactqp.study.friction_printing import print_outcomes

        solved = run_files(foreign, methods, knobs, drawn=bool(plot or vtu), progress=sys.stderr.isatty())
        for message in (outcome.failure for outcome in solved if outcome.failure is not None):
            complain(message)
        if as_json:
            data += [outcome_data(outcome) for outcome in solved]
        else:
            print_outcomes(terminal, solved)
        met = met and all(outcome.passed for outcome in solved)
    if as_json:
        print_json(data)
    sys.exit(0 if met else NOT_MET)
