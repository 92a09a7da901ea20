"""Pictures and VTU files of the answer to a scene: its fields, its figures, and the files of the command line."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.analysis.history import History
from contactqp.analysis.large.deformation import LargeSolution
from contactqp.analysis.load_cases import Solutions
from contactqp.elements.pairing import Pairing
from contactqp.elements.solid import Membrane
from contactqp.elements.structure import Assembly, System
from contactqp.errors import ContactQPError, InvalidProblem, Unsupported
from contactqp.exchange.files import check_file, check_installed, write_whole
from contactqp.exchange.problem_files import is_deck
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array
from contactqp.model.problem import Units
from contactqp.model.solution import Solution
from contactqp.pictures.contact_fields import (
    HELD,
    ContactFields,
    contact_fields,
    contacts_of,
    fields_of_deck,
    fields_of_solid,
)
from contactqp.pictures.drawing import figure
from contactqp.pictures.frame_drawing import FrameContact, FrameFields, Member, solution_figure, structure_figure
from contactqp.pictures.history_drawing import cases_figure, draw_history, history_figure
from contactqp.pictures.space_drawing import MembraneFields, membrane_figure
from contactqp.pictures.style import check_picture, save, small_png, thumbnail
from contactqp.pictures.vtu import check_vtu, write_vtu
from contactqp.scene.answers import clean_gaps
from contactqp.scene.building import exact_problem
from contactqp.scene.deck.deck import Deck, read_deck
from contactqp.scene.geometry import obstacle
from contactqp.scene.judging import Failure, Judgement, Trial
from contactqp.scene.scene import load_scene
from contactqp.scene.schema import SceneData

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def fields_of(scene: SceneData, solution: Solution) -> ContactFields | FrameFields:
    """Return the fields of a scene's solution, in the scene's units.

    This decides what kind of picture a scene gets. Bars, springs, beams, strings and matrices give
    FrameFields. Elastic bodies give the ContactFields of the System and the Pairings that the scene's problem is made
    of; draw, write_vtu and the command line take either.

    Raises Unsupported: the scene has a membrane.

    Parameters
    ----------
    scene : Scene
    solution : a solution of ``scene.problem()``, by any method
    """
    if scene.meshed:
        return _fields_of_bodies(scene, solution)
    exact = exact_problem(scene)
    unknowns = exact.unknowns
    _refuse_another("scene", len(unknowns.free), solution)
    value = dict.fromkeys(unknowns.names, 0.0) | dict(zip(unknowns.free, solution.displacement.tolist(), strict=True))
    under = np.asarray(getattr(solution, "load", solution.problem.load))
    load = dict.fromkeys(unknowns.names, 0.0) | exact.load_on_all(under)
    return FrameFields(
        axes=scene.axes,
        nodes=tuple(scene.every_node),
        position=np.array([_point(scene, node) for node in scene.every_node]),
        displacement=np.array([[value[name] for name in scene.displacements(node)] for node in scene.every_node]),
        held=np.array([[name in unknowns.fixed for name in scene.displacements(node)] for node in scene.every_node]),
        load=np.array([[load[name] for name in scene.displacements(node)] for node in scene.every_node]),
        members=tuple(_members(scene, value)),
        contacts=tuple(_contacts(scene, solution)),
        units=Units(length=scene.units.length, force=scene.units.force),
    )


def fields_of_membranes(scene: SceneData, solution: Solution) -> MembraneFields:
    """Return the fields of a scene of membranes, which have no stresses; contacts at supported nodes are "held"."""
    from contactqp.scene.body_model import body_model

    model = body_model(scene)
    return _membranes(model.system, [contact.pairing for contact in model.contacts], solution)


def _membranes(system: System, pairings: Sequence[Pairing], solution: Solution) -> MembraneFields:
    kept = contacts_of(solution, system, pairings)
    structure, w = system.structure, system.expand(solution.displacement)
    position = np.concatenate([np.zeros((0, 2)), *(pairing.points[:, :2] for pairing in pairings)])
    force, status = np.full(len(position), np.nan), np.full(len(position), HELD, dtype="<U8")
    force[kept], status[kept] = solution.normal_force, solution.contact_status
    first = [structure.first(body.name) for body in structure.bodies]
    return MembraneFields(
        meshes=tuple(body.mesh for body in structure.bodies),
        deflections=tuple(w[i : i + body.size] for i, body in zip(first, structure.bodies, strict=True)),
        position=position,
        force=force,
        status=status,
        units=solution.problem.units,
    )


def _fields_of_bodies(scene: SceneData, solution: Solution) -> ContactFields:
    from contactqp.scene.body_model import body_model

    model = body_model(scene)
    pairings, names = [c.pairing for c in model.contacts], [c.name for c in model.contacts]
    return contact_fields(model.system, pairings, solution, names=names)


def _members(scene: SceneData, value: Mapping[str, float]) -> Iterator[Member]:
    place = _places(scene)
    for _, element in scene.elements:
        line = element.drawn(scene, value)
        if line is not None:
            nodes = tuple(place[name] for name in line.nodes)
            yield Member(element.noun, nodes, line.path, line.displacement)


def _contacts(scene: SceneData, solution: Solution) -> Iterator[FrameContact]:
    place, gaps = _places(scene), clean_gaps(solution)
    for i, (contact, form) in enumerate(zip(scene.contacts, exact_problem(scene).contacts, strict=True)):
        push = [[-float(form.normal.get(name, 0)) for name in scene.displacements(node)] for node in contact.touched]
        initial_gap = float(form.gap)
        if isinstance(solution, LargeSolution) and solution.position is not None:
            # The plane that touches the obstacle at the point nearest to the node, as a gap from the initial node.
            normal = obstacle(scene, str(contact.obstacle)).normals(solution.position[i : i + 1])[0]
            push = [[float(x) for x in normal]]
            moved = solution.position[i] - _point(scene, contact.touched[0])
            initial_gap = float(gaps[i] - normal @ moved)
        yield FrameContact(
            name=contact.name,
            nodes=tuple(place[name] for name in contact.touched),
            push=np.array(push),
            force=float(solution.normal_force[i]),
            gap=float(gaps[i]),
            initial_gap=initial_gap,
            status=str(solution.contact_status[i]),
            friction=_friction(scene, contact, form, solution, i),
        )


def _friction(scene: SceneData, contact: Any, form: Any, solution: Solution, i: int) -> Array | None:
    """Return -E_T' l_T of one contact on each of its nodes (1 or 2, d), None without friction.

    At large deformation the tangents are those at the current position of the node.
    """
    if solution.friction_force is None or isinstance(solution, LargeSolution):
        return None
    force = solution.friction_force[i]
    along = [
        [sum(-float(row.get(name, 0)) * part for row, part in zip(form.tangent, force, strict=True)) for name in names]
        for names in map(scene.displacements, contact.touched)
    ]
    return np.array(along)


def _places(scene: SceneData) -> dict[str, int]:
    return {node: i for i, node in enumerate(scene.every_node)}


def _point(scene: SceneData, name: str) -> Array:
    return np.array(scene.point(name), dtype=float)


# Times of scenes are in seconds.
TIME_UNIT = "s"
# Dots per inch at which the smallest text is still legible; figures of bodies are larger.
DPI, DPI_OF_BODIES = 90.0, 75.0


def answer_figure(
    scene: SceneData | Deck, solution: Solution, *, title: str = "", scale: float | None = None
) -> Figure:
    """Return the figure of geometry, deformed shape and contact forces; large displacements are true to scale.

    `scale` magnifies displacements; by default it is chosen, and membranes have their own.

    Parameters
    ----------
    scene : SceneData or Deck
    solution : a solution of the scene's problem
    title : str
    scale : by how much displacements are magnified
    """
    if isinstance(scene, Deck):
        if not scene.assembly.bodies:  # the deck has only trusses and springs
            return solution_figure(solution, title=title)
        return figure(fields_of_deck(scene, solution), title=title, scale=scale)
    if scene.membranes:
        return membrane_figure(fields_of_membranes(scene, solution), title=title)
    fields = fields_of(scene, solution)
    if isinstance(fields, ContactFields):
        return figure(fields, title=title, scale=scale)
    return structure_figure(fields, scale=1.0 if scene.large and scale is None else scale, title=title)


@checked
def draw(
    answer: Solution | History | Solutions,
    file: str | Path | None = None,
    *,
    scene: SceneData | Deck | str | Path | None = None,
    system: System | None = None,
    contacts: Sequence[Pairing] = (),
    title: str = "",
    scale: float | None = None,
    time_unit: str = "",
    names: Sequence[str] | None = None,
) -> Figure:
    """Draw an answer: bodies and structures where their geometry is known, a history, else forces and gaps as bars.

    A solution of ``system.problem(...)`` knows its bodies, and one of `large_deformation` its solid, which is drawn
    true to scale. A history is drawn over time or load, many load cases over their numbers.

    Parameters
    ----------
    answer : Solution, History or Solutions
        What `solve`, `solve_many`, `run`, `follow_path`, `impact` or `large_deformation` return, or the `history` of a
        `NotConverged`. Of a history with geometry, and of one of a single instant, the last solution is drawn.
    file : str or Path, optional
        A file to write, which ends in .png, .pdf or .svg.
    scene : Scene, Deck, or str or Path of a case file or a deck, optional
        The scene that was run: draws what ``contactqp run CASE --plot FILE`` does.
    system, contacts : System and sequence of Pairing, optional
        ``structure.assemble(...)`` and the pairings of ``system.problem(contacts)``: draws the deformed bodies with the
        pressure at their contacts, where the problem of the solution was made in another way or is a copy.
    title : str
        The title of the picture.
    scale : float, optional
        The factor by which displacements of bodies and structures are magnified. By default it makes them visible, and
        bodies that meet across a gap, or that an interference presses together, overlap or part in the picture by no
        more than a five-hundredth of their size. The title states it. Membranes, histories and bars have none.
    time_unit : str
        Unit of the times of a motion, for labels.
    names : sequence of str, optional
        What load cases are called, one name each; they stand below the axis where the cases are few.

    Returns
    -------
    matplotlib.figure.Figure
        The figure, which a notebook shows.

    Raises
    ------
    InvalidProblem
        The suffix is unknown, the folder does not exist, the answer is not a Solution, History or Solutions, or it is
        not one of this system or this scene.
    Unsupported
        The numbers are so large or so far apart that matplotlib has no axes for them.
    BackendMissing
        matplotlib is not installed.

    Examples
    --------
    >>> import contactqp as cq
    >>> wall = cq.ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3])
    >>> figure = cq.draw(cq.solve(wall))
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['normal force [force]', 'gap [length]']
    """
    check_installed("matplotlib", "drawing")
    path = None if file is None else check_picture(file)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            if isinstance(answer, Solutions):
                if scene is not None or system is not None:
                    raise InvalidProblem("draw: many load cases are drawn as curves; with a scene or a system one [i]")
                drawn = cases_figure(answer, title=title, names=names)
            elif scene is None and system is None and isinstance(answer, History) and len(answer) > 1:
                drawn = history_figure(answer, title=title, time_unit=time_unit)
            else:
                drawn = _drawn(answer, scene, system, contacts, title, scale)
            if path is not None:
                save(drawn, path)
    except (ValueError, ArithmeticError) as error:
        beyond = isinstance(error, np.linalg.LinAlgError | ArithmeticError) or "NaN or Inf" in str(error)
        if isinstance(error, ContactQPError) or not beyond:
            raise
        raise Unsupported(f"draw: numbers so large or so far apart have no axes ({error}); state other units") from None
    return drawn


def _drawn(
    answer: Solution | History,
    scene: SceneData | Deck | str | Path | None,
    system: System | None,
    contacts: Sequence[Pairing],
    title: str,
    scale: float | None,
) -> Figure:
    solution = answer[-1] if isinstance(answer, History) else answer
    if scene is not None and system is not None:
        raise InvalidProblem("draw: expected a scene or a system, got both")
    if scene is not None:
        read = (read_deck if is_deck(scene) else load_scene)(scene) if isinstance(scene, str | Path) else scene
        called = Path(read.model.file).stem if isinstance(read, Deck) else read.title
        return answer_figure(read, solution, title=title or called, scale=scale)
    if system is not None:
        _refuse_another("system", len(system.free), solution)
        return _figure_of_system(system, contacts, solution, title, scale)
    assembly = solution.problem._computed.assembly
    if isinstance(assembly, Assembly):
        of_load = assembly.under(solution.problem.load)
        return _figure_of_system(of_load, assembly.pairings, solution, title, scale)
    solid = fields_of_solid(solution)
    if solid is not None:
        return figure(solid, title=title, scale=1.0 if scale is None else scale)
    drawn = solution_figure(solution, title=title)
    if solution.problem.near_null_space is not None:
        for legend in drawn.legends:  # below everything else, so that it overlaps no other text
            legend.set_title(HOW_BODIES)
            legend.get_title().set_fontsize("x-small")
    return drawn


def _figure_of_system(
    system: System, pairings: Sequence[Pairing], solution: Solution, title: str, scale: float | None
) -> Figure:
    """Return the figure of elastic bodies or of membranes."""
    if any(isinstance(body, Membrane) for body in system.structure.bodies):
        return membrane_figure(_membranes(system, pairings, solution), title=title)
    return figure(contact_fields(system, pairings, solution), title=title, scale=scale)


HOW_BODIES = "draw(solution, system=..., contacts=[...]) draws the bodies, scene=... those of a case file or a deck"


def _refuse_another(what: str, unknowns: int, solution: Solution) -> None:
    """Raise InvalidProblem where a solution is one of another scene or system."""
    if unknowns != len(solution.displacement):
        raise InvalidProblem(
            f"draw: expected the {what} of this solution, which has {len(solution.displacement)} unknowns, got one of "
            f"{unknowns}"
        )


@dataclass(frozen=True)
class AnswerPictures:
    """Pictures of one answer as PNG; None where there is nothing to draw."""

    answer: bytes | None = None
    history: bytes | None = None  # of a path or a motion
    thumbnail: bytes | None = None
    why_not: str = ""  # why there is no picture of the answer


def answer_pictures(outcome: Judgement | Failure) -> AnswerPictures:
    """Return small pictures for a page, without the case's title, or the reason why there is none."""
    if importlib.util.find_spec("matplotlib") is None:
        return AnswerPictures(why_not="matplotlib is not installed: pip install matplotlib")
    history = None if outcome.history is None else _history(outcome.history)
    if isinstance(outcome, Failure):
        return AnswerPictures(history=history, why_not=outcome.message)
    try:
        drawn = answer_figure(outcome.scene, outcome.solution)
    except ContactQPError as error:
        return AnswerPictures(history=history, why_not=str(error))
    answer = small_png(drawn, DPI_OF_BODIES if outcome.scene.meshed else DPI)
    return AnswerPictures(answer, history, thumbnail(drawn))


def _history(history: History) -> bytes | None:
    """Return the picture of a history; None for one of a single instant."""
    return small_png(history_figure(history, time_unit=TIME_UNIT), DPI) if len(history) > 1 else None


# Part of the file name of the picture of a history, after case and method.
HISTORY = "history"


@dataclass(frozen=True)
class AnswerFiles:
    """The files that answers are drawn and written to.

    Parameters
    ----------
    plot, vtu, csv : Path or None
        The files that were asked for. With several cases the name of the case is put before the suffix, with several
        answers of one case the method too: ``bar.png`` becomes ``bar.truss_floor.lemke.png``. A history is drawn to a
        picture of its own, ``bar.history.png``.
    several_cases : bool, whether names of cases are put into file names
    every_method : bool, write all answers of a case; otherwise the first one, which is printed in full
    """

    plot: Path | None
    vtu: Path | None
    csv: Path | None
    several_cases: bool
    every_method: bool

    def write(self, outcomes: Sequence[Judgement | Failure]) -> list[Path]:
        """Write the files of one scene's outcomes, and return them.

        A trial without an answer has no files, except the picture and the table of a history that was cut short.
        """
        chosen = outcomes if self.every_method else outcomes[:1]
        written = []
        for outcome in chosen:
            names = [_stem(outcome.scene)] if self.several_cases else []
            names += [_slug(outcome.trial)] if len(chosen) > 1 else []
            if isinstance(outcome, Judgement):
                written += self._write_one(outcome, names)
            elif outcome.history is not None:
                title = f"{outcome.scene.title}, {outcome.trial}, as far as it came"
                written += self._write_history(outcome.history, title, names)
                written += self._write_table(outcome, names)
        return written

    def _write_one(self, judgement: Judgement, names: Sequence[str]) -> list[Path]:
        written = []
        if self.plot is not None:
            written.append(named_file(self.plot, names))
            title = f"{judgement.scene.title}, {judgement.trial}"
            save(answer_figure(judgement.scene, judgement.solution, title=title), written[-1])
            written += self._write_history(judgement.history, title, names)
        if self.vtu is not None:
            written.append(named_file(self.vtu, names))
            write_vtu(fields_of(judgement.scene, judgement.solution), written[-1])
        return [*written, *self._write_table(judgement, names)]

    def _write_table(self, outcome: Judgement | Failure, names: Sequence[str]) -> list[Path]:
        """Write every contact at every instant and return the file."""
        history = outcome.history
        if self.csv is None or history is None:
            return []
        file = named_file(self.csv, names)
        write_whole(file, history.write_csv)
        return [file]

    def _write_history(self, history: History, title: str, names: Sequence[str]) -> list[Path]:
        """Draw a path or a motion and return the file; a history of one instant has none."""
        if self.plot is None or len(history) < 2:
            return []
        file = named_file(self.plot, [*names, HISTORY])
        draw_history(history, file, title=title, time_unit=TIME_UNIT)
        return [file]


def answer_files(
    scenes: Sequence[SceneData], plot: str | None, vtu: str | None, csv: str | None, *, every_method: bool
) -> AnswerFiles:
    """Check the files that the command line asks for, before anything is solved.

    Parameters
    ----------
    scenes : sequence of Scene
        The cases.
    plot, vtu, csv : str or None
        The files of pictures, of fields, and of tables of contacts.
    every_method : bool
        Write all answers of a case, not the first one alone.

    Raises
    ------
    InvalidProblem
        A suffix is wrong, a folder does not exist, or two cases would write to one file.
    BackendMissing
        matplotlib or meshlane is not installed.
    """
    stems = [_stem(scene) for scene in scenes]
    stems += [f"{stem}.{HISTORY}" for stem in stems if plot is not None]
    twice = next((stem for stem in stems if stems.count(stem) > 1), None)
    if twice is not None:
        asked = Path(next(str(file) for file in (plot, vtu, csv) if file is not None))
        raise InvalidProblem(
            f"{asked}: expected cases whose files have distinct names, got {twice!r} more than once: they would all be "
            f"written to {named_file(asked, [twice])}"
        )
    return AnswerFiles(
        None if plot is None else check_picture(plot),
        None if vtu is None else check_vtu(vtu),
        None if csv is None else check_file(csv, (".csv",)),
        len(scenes) > 1,
        every_method,
    )


def _stem(scene: SceneData) -> str:
    return scene.file.stem if scene.file is not None else scene.title


def _slug(trial: Trial) -> str:
    """Return the trial as a part of a file name: ``penalty-penalty=1e8-kN-m``."""
    return re.sub(r"[^\w.+=-]+", "-", str(trial))


def named_file(file: Path, names: Sequence[str]) -> Path:
    """Return a file with names put before its suffix: ``bar.png`` becomes ``bar.truss_floor.lemke.png``."""
    return file.with_name(".".join([file.stem, *names]) + file.suffix)
