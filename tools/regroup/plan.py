# ruff: noqa
"""The plan: which modules become one, and where they go. A `*` takes all of a folder that is not named elsewhere.

The first source of a target leads: its docstring is the target's, unless DOC has one or a folder of that name had one.
"""

from __future__ import annotations

import re

MERGE: dict[str, list[str]] = {
    # ---------------------------------------------------------------- ground
    "text_files": ["text_files", "strict_json", "escaping"],
    "progress": ["progress", "workers", "blas"],
    "files.single_file": ["files.single_file", "files.renames", "files.growing", "files.arrow", "files.endings"],
    "files.publish": ["files.publish", "files.manifest", "files.target", "files.workplace", "files.swap"],
    # ---------------------------------------------------------------- beam
    "beam.grid": ["beam.grid", "beam.modal"],
    "beam.stiffness": [
        "beam.profiles.stiffness",
        "beam.profiles.polyline",
        "beam.profiles.piecewise",
        "beam.profiles.rectangular",
        "beam.profiles.uncertain",
    ],
    "beam.section": ["beam.profiles.section", "beam.profiles.measured_section", "beam.profiles.modulus"],
    "beam.problem": ["beam.statics.problem", "beam.statics.rod", "beam.statics.nodal_beam"],
    "beam.statics": ["beam.statics.equilibrium", "beam.statics.nodal_forces", "beam.statics.newton"],
    "beam.sensitivity": ["beam.statics.sensitivity", "beam.statics.perturbation"],
    "beam.continuation": [
        "beam.statics.one_sided",
        "beam.statics.continuation",
        "beam.statics.by_load",
        "beam.statics.moment_basis",
        "beam.statics.snap_through",
    ],
    "beam.branches": ["beam.statics.shooting", "beam.statics.turning"],
    "beam.clamped_ends": ["beam.clamped_ends.search", "beam.clamped_ends.*"],
    "beam.dynamics": ["beam.motion.dynamics", "beam.motion.actions"],
    "beam.integration": ["beam.motion.integration", "beam.motion.stepping", "beam.motion.collocation"],
    "beam.vibration": ["beam.motion.vibration", "beam.motion.frequencies"],
    # ---------------------------------------------------------------- recording
    "recording.signals": ["recording.signals", "recording.dropped_samples"],
    "recording.schema": ["recording.toml.schema"],
    "recording.entries": [
        "recording.toml.entries",
        "recording.toml.beam_entry",
        "recording.toml.source_entries",
        "recording.toml.frequency_entry",
    ],
    "recording.description": ["recording.toml.description", "recording.toml.implausible_entries"],
    "recording.folder": [
        "recording.folder",
        "recording.toml.same_beam",
        "recording.camera.bag_calibration",
        "recording.template",
    ],
    "recording.bags": ["recording.bags.reader", "recording.bags.message_types", "recording.bags.type_limits"],
    "recording.damaged_bags": [
        "recording.bags.sequential_scan",
        "recording.bags.items",
        "recording.bags.sqlite_pages",
        "recording.bags.rosbags_internals",
    ],
    "recording.bag_topics": [
        "recording.bags.topics",
        "recording.bags.message_times",
        "recording.bags.film_topic",
        "recording.bags.camera_topic",
        "recording.bags.force_topic",
        "recording.bags.recorded_topics",
    ],
    "recording.force_log": ["recording.force.force_log", "recording.force.franka", "recording.force.implausible_force"],
    "recording.force": [
        "recording.force.cleaning",
        "recording.force.contact",
        "recording.force.load_stages",
        "recording.force.noise",
        "recording.force.noise_factor",
    ],
    "recording.video": ["recording.video", "recording.kept_frames"],
    "recording.beam_frame": ["recording.beam_frame", "recording.gravity"],
    "recording.pairing": ["recording.pairing", "recording.implausible_axes"],
    "recording.camera": [
        "recording.camera.projection",
        "recording.camera.lens",
        "recording.camera.lens_models",
        "recording.camera.plane",
        "recording.camera.tag_poses",
        "recording.camera.base",
        "recording.camera.tag_turns",
    ],
    "recording.calibration": ["recording.calibration.intrinsics", "recording.calibration.boards"],
    "recording.clock_likelihood": [
        "recording.clock.likelihood",
        "recording.clock.binned_log",
        "recording.clock.polynomial_features",
        "recording.clock.span_moments",
        "recording.clock.moment_posterior",
    ],
    "recording.clock": [
        "recording.clock.offset",
        "recording.clock.offset_prior",
        "recording.clock.feature_search",
        "recording.clock.messages",
        "recording.clock.sensor_lag",
    ],
    "recording.tag_finder": ["recording.tags.finder", "recording.tags.printed_code", "recording.tags.pattern"],
    "recording.tags": [
        "recording.tags.detection",
        "recording.tags.tracking",
        "recording.tags.still_tags",
        "recording.tags.frozen",
        "recording.tags.tracker",
    ],
    "recording.tool": [
        "recording.tool.film",
        "recording.tool.covered",
        "recording.tool.strips",
        "recording.tool.place",
        "recording.tool.kept_small",
    ],
    "recording.tracks": [
        "recording.tracks.marker_tracks",
        "recording.tracks.chords",
        "recording.tracks.plane_fit",
        "recording.tracks.swing_signals",
        "recording.tracks.measured_frequencies",
    ],
    "recording.poses": [
        "recording.tracks.pose_tables",
        "recording.tracks.pose_loads",
        "recording.tracks.pose_readings",
        "recording.photos",
    ],
    # ---------------------------------------------------------------- learning
    "learning.allowances": [
        "learning.allowances.chosen",
        "learning.allowances.allowance",
        "learning.allowances.course",
        "learning.allowances.*",
    ],
    "learning.outcome": ["learning.outcome", "learning.modulus"],
    "learning.parameters": [
        "learning.model.parameters",
        "learning.known_shape",
        "learning.model.spline",
        "learning.model.mass",
    ],
    "learning.frames": ["learning.model.frames", "learning.model.readings"],
    "learning.fit_data": ["learning.model.fit_data", "learning.model.rest", "learning.model.own_weight"],
    "learning.static_poses": ["learning.pose_equilibria", "learning.model.held_ends"],
    "learning.force_error": ["learning.model.force_error"],
    "learning.condensed": ["learning.model.condensed"],
    "learning.prediction": [
        "learning.model.forward",
        "learning.model.tag_jacobian",
        "learning.model.allowed",
        "learning.model.memory",
        "learning.model.prediction_error",
    ],
    "learning.frequencies": ["learning.frequencies.predicted", "learning.frequencies.*"],
    "learning.normal": [
        "learning.inference.information_form",
        "learning.inference.block_root",
        "learning.inference.joint_covariance",
        "learning.inference.stiffness_prior",
    ],
    "learning.linear": [
        "learning.inference.linear_gaussian",
        "learning.inference.joint",
        "learning.inference.fit_problem",
    ],
    "learning.hyperparameters": ["learning.inference.hyperparameters", "learning.inference.allowance_sizes"],
    "learning.optimizer": [
        "learning.inference.optimizer",
        "learning.inference.descent",
        "learning.inference.misfit",
        "learning.inference.stages",
        "learning.inference.pose_branches",
    ],
    "learning.posterior": [
        "learning.posterior",
        "learning.stiffness_band",
        "learning.learned_mass",
        "learning.inference.nuisances",
        "learning.tradeoffs",
    ],
    "learning.verdict": ["learning.verdict", "learning.criticism_messages", "learning.explained"],
    "learning.push_place": ["learning.criticism.push_place", "learning.criticism.place_evidence"],
    "learning.criticism": [
        "learning.criticism.criticism",
        "learning.criticism.score_tests",
        "learning.criticism.alternatives",
    ],
    "learning.swing": [
        "learning.swing.damping",
        "learning.swing.free_swing",
        "learning.swing.swing_fit",
        "learning.swing.swing_motion",
    ],
    "learning.swing_frequencies": ["learning.swing.swing_frequencies"],
    "learning.paper": ["learning.paper.learn", "learning.paper.*"],
    "learning.endings": ["learning.endings.let_go", "learning.endings.*"],
    "learning.sensing.bench": [
        "learning.sensing.bench",
        "learning.sensing.prior",
        "learning.sensing.tags",
        "learning.sensing.begin",
    ],
    "learning.sensing.forces": [
        "learning.sensing.estimate",
        "learning.sensing.frame_forces",
        "learning.sensing.joint",
        "learning.sensing.search",
    ],
    "learning.sensing.contacts": ["learning.sensing.two", "learning.sensing.smooth", "learning.sensing.edges"],
    "learning.sensing.sense": ["learning.sensing.sense", "learning.sensing.sensed", "learning.sensing.online"],
    "learning.instruments": ["learning.design.instruments"],
    "learning.design": [
        "learning.design.planning",
        "learning.design.candidates",
        "learning.design.identifiability",
        "learning.design.proposals",
    ],
    # ---------------------------------------------------------------- control
    "control.goals": ["control.goals.targets", "control.goals.moving_goals", "control.goals.target_files"],
    "control.loaded_beam": [
        "control.reach.loaded_beam",
        "control.reach.newton",
        "control.reach.continuation",
        "control.reach.starts",
        "control.reach.settings",
        "control.reach.paper_iteration",
    ],
    "control.reach_set": ["control.reach.reachable", "control.reach.reach_map", "control.reach.drag"],
    "control.reach": [
        "control.reach.reach",
        "control.reach.known",
        "control.reach.search",
        "control.reach.tracking",
        "control.reach.uncertainty",
    ],
    "control.shape": ["control.shape.shape", "control.shape.*"],
    "control.path": [
        "control.path.follow",
        "control.path.batch_newton",
        "control.path.first_pass",
        "control.path.force_interpolation",
        "control.path.path_spread",
        "control.path.timing",
    ],
    "control.trajectory_files": ["control.path.trajectory_files"],
    "control.loop": [
        "control.loop.controller",
        "control.loop.felt",
        "control.loop.plant",
        "control.loop.margins",
        "control.loop.tuning",
    ],
    "control.loop_simulation": ["control.loop.simulation", "control.loop.robustness"],
    # ---------------------------------------------------------------- report, results, export
    "report.wording": ["report.wording", "report.findings", "report.kinds", "report.figures.bands"],
    "report.confidence": ["report.confidence", "report.allowance_words", "report.modulus"],
    "report.style": ["report.figures.style"],
    "report.pictures": ["report.figures.pictures", "report.figures.film"],
    "report.figures": [
        "report.figures.drawing",
        "report.figures.recordings",
        "report.figures.curves",
        "report.figures.simulated",
        "report.figures.checking",
    ],
    "report.control_figures": [
        "report.figures.reaching",
        "report.figures.shaping",
        "report.figures.looping",
        "report.figures.sensing",
    ],
    "report.page": [
        "report.page.page",
        "report.page.template",
        "report.page.cards",
        "report.page.interactive",
        "report.page.made_from",
    ],
    "results.model": ["results.model", "results.origin"],
    "results.provenance": ["results.provenance", "results.recording_files"],
    "results.observations_file": ["results.observations_file", "results.record_json"],
    "results.learned_files": ["results.learned_files", "results.summary"],
    "results.control_files": ["results.reaching", "results.shaping", "results.looping"],
    "results.sensing": ["results.sensing", "export.force_bag"],
    "export.export": [
        "export.export",
        "export.checks",
        "export.chain",
        "export.mujoco",
        "export.robot",
        "export.pyelastica",
        "export.function",
        "export.table",
    ],
    # ---------------------------------------------------------------- the command line
    "cli.common": ["cli.common", "cli.options", "terminal.bars", "terminal.parts"],
    "cli.screens": ["terminal.screens", "terminal.tables", "terminal.plots", "terminal.damping"],
    "cli.learning": ["cli.learning", "terminal.plans"],
    "cli.models": ["cli.models", "cli.exporting"],
    "cli.control": ["cli.control", "cli.shaping", "terminal.reaching", "terminal.shaping", "terminal.looping"],
    "cli.recordings": ["cli.recordings", "cli.calibrating", "terminal.recordings", "terminal.calibrating"],
    "lazy": ["lazy", "cli.place"],
    # ---------------------------------------------------------------- live
    "live.commands": ["cli.recording_live", "terminal.recording_live"],
    "many.commands": ["cli.long_runs", "terminal.long_runs"],
    "lab.commands": ["cli.making", "cli.filming", "terminal.making"],
    "lab.rehearsal_commands": [
        "cli.rehearsing",
        "cli.looping",
        "cli.reproducing",
        "terminal.rehearsals",
        "terminal.reproducing",
    ],
    "studio.commands": ["cli.studio"],
    "live.history": ["streaming.history", "streaming.reading"],
    "live.review": ["streaming.review", "streaming.reviewer"],
    "live.live": ["streaming.live", "streaming.following", "streaming.state"],
    "live.played": ["capture.played", "streaming.played"],
    "live.key_frames": ["learning.live.key_frames", "learning.allowances.causal", "learning.live.force_process"],
    "live.posterior": ["learning.live.key_frame_posterior", "learning.live.marginalised", "learning.live.tag_noise"],
    "live.model": ["learning.live.session", "learning.live.forward", "learning.live.linearised_frames"],
    "live.hyperparameters": [
        "learning.live.settings",
        "learning.live.force_hyperparameters",
        "learning.live.stiffness_hyperparameters",
    ],
    "live.learner": [
        "learning.live.online_learner",
        "learning.live.smoother",
        "learning.live.incoming_frame",
        "learning.live.doubts",
    ],
    "live.replayed": ["learning.replay"],
    "live.sources": ["capture.sources", "capture.clocks"],
    "live.force_sensors": [
        "capture.devices.cells",
        "capture.devices.ati",
        "capture.devices.lines",
        "capture.devices.packages",
        "capture.devices.growing_bag",
    ],
    "live.cameras": ["capture.devices.v4l2", "capture.devices.inputs", "capture.devices.realsense"],
    "live.specs": ["capture.specs"],
    "live.recording_folder": ["capture.folder", "capture.film_writer", "capture.logs", "capture.pump"],
    "live.guidance": ["capture.stages", "capture.guidance", "capture.state"],
    "live.session": ["capture.session", "capture.follower", "capture.next_push"],
    # ---------------------------------------------------------------- many
    "many.tasks": ["batch.task", "batch.listing", "batch.record", "batch.engine"],
    "many.batch": ["batch.run", "batch.outcome", "batch.outliers", "batch.tables", "batch.page", "batch.writing"],
    "many.population": [
        "population.fit",
        "population.objects",
        "population.gaussians",
        "population.covariances",
        "population.reading",
        "population.curves",
        "population.needed",
        "population.outliers",
        "population.shares",
        "population.tolerance",
    ],
    "many.population_report": [
        "population.outcome",
        "population.tables",
        "population.figures",
        "population.page",
        "population.writing",
    ],
    # ---------------------------------------------------------------- lab
    "lab.designs": ["lab.designs", "lab.materials", "lab.design_file", "lab.expected", "lab.random_beams"],
    "lab.bench": ["lab.effects.real_bench", "lab.effects.posture_bias", "lab.pushes", "lab.sensors", "lab.tag_errors"],
    "lab.virtual": ["lab.virtual", "lab.direct_observation"],
    "lab.rod": ["lab.effects.rod_march", "lab.extensible"],
    "lab.rendering": [
        "lab.filming.render",
        "lab.filming.raster",
        "lab.filming.scene",
        "lab.filming.viewpoint",
        "lab.filming.in_space",
    ],
    "lab.filming": [
        "lab.filming.film",
        "lab.filming.*",
        "lab.effects.camera_motion",
        "lab.effects.droop",
        "lab.marker_folder",
    ],
    "lab.random_bench": ["lab.random_bench", "lab.random_effects", "lab.film_request"],
    "lab.fabrication": [
        "lab.fabrication.mould",
        "lab.fabrication.solids",
        "lab.fabrication.clamp",
        "results.fabrication",
        "report.figures.parts",
    ],
    "lab.sheet": ["lab.fabrication.sheet", "lab.fabrication.page"],
    "lab.forecast": ["forecast.prediction", "forecast.setup", "forecast.instruments", "forecast.advice"],
    "lab.rehearsal": ["forecast.rehearsal", "forecast.runs", "forecast.figure", "forecast.writing"],
    "lab.sensed_force": ["forecast.sensed_force"],
    "lab.study": [
        "studies.run",
        "studies.settings",
        "studies.printed",
        "studies.films",
        "studies.learned",
        "studies.manipulation",
        "studies.outcome",
        "studies.assumed",
    ],
    "lab.study_report": ["studies.tables", "studies.figures", "studies.page", "studies.writing"],
    # ---------------------------------------------------------------- studio
    "studio.places": ["studio.places", "studio.guard", "studio.commands"],
    "studio.desk": ["studio.desk", "studio.clients"],
    "studio.bending": ["studio.bending", "studio.mapping"],
}
MOVE: dict[str, str] = {}
DATA: dict[str, str] = {
    "batch/page.html": "many/batch.html",
    "population/page.html": "many/population.html",
    "studies/page.html": "lab/study.html",
}
# definitions that say the same as another one, but for a comment
SAME: dict[str, str] = {"recording.toml.implausible_entries.SOURCES": "recording.toml.description.SOURCES"}
# names that would clash in their new module
RENAME: dict[str, str] = {
    "strict_json._ACTING": "_NOT_IN_JSON",
    "escaping._ACTING": "_NOT_TEXT",
    "files.workplace.LARGEST": "LARGEST_MARKER",
    "beam.profiles.measured_section._PLACES": "_SECTION_PLACES",
    "beam.profiles.modulus._PLACES": "_MEAN_PLACES",
    "beam.statics.one_sided._TRUST": "_FARTHEST_FROM_LINEAR",
    "beam.statics.shooting._TRUST": "_FARTHEST_FROM_MARCH",
    "beam.statics.turning._TRUST": "_LARGEST_TURN",
    "beam.clamped_ends.homotopy._TRUST": "_LARGEST_TURN",
    "beam.clamped_ends.near_shape._TRUST": "_SAME_EQUILIBRIUM",
    "recording.template.EMPTY": "TO_FILL_IN",
    "recording.toml.same_beam.check_together": "check_same_beam",
    "recording.bags.force_topic.fields_of": "field_names",
    "recording.kept_frames.MOST_PIXELS": "MOST_KEPT_PIXELS",
    "recording.clock.moment_posterior.FINEST": "LEAST_SD",
    "recording.clock.likelihood.FREE": "FREE_BIAS",
    "recording.clock.sensor_lag.APART": "LAGS_APART",
    "recording.tool.place._elsewhere": "_away_from",
    "recording.tool.film._elsewhere": "_tool_elsewhere",
    "recording.force.franka.hint": "franka_hint",
    "learning.model.memory._responses": "_responses_with_memory",
    "learning.model.forward._responses": "_responses_at_once",
    "learning.criticism_messages._weight": "_weight_words",
    "learning.verdict._weight": "_weight_remarks",
    "learning.paper.inverse_kinematics._whitening": "_tag_whitening",
    "learning.paper.regression._whitening": "_residual_whitening",
    "learning.endings.straight._AFTER": "_FRAMES_AFTER",
    "learning.endings.straight._BEFORE": "_FRAMES_BEFORE",
    "learning.endings.release._AFTER": "_SWINGS_AFTER",
    "learning.endings.release._BEFORE": "_SWINGS_BEFORE",
    "learning.endings.straight._PLACES": "_END_TIMES",
    "learning.endings.release._PLACES": "_RELEASE_TIMES",
    "learning.endings.straight._REST": "_REST_SDS",
    "learning.endings.let_go._REST": "_REST_FRAMES",
    "learning.endings.forced._SLIGHT": "_SLIGHT_DAMPING",
    "learning.endings.let_go._SLIGHT": "_SLIGHT_SWING",
    "learning.endings.straight._sds": "_bending_sds",
    "learning.endings.release._sds": "_swing_sds",
    "learning.sensing.estimate._MOST": "_MOST_DAMPING",
    "learning.sensing.joint._MOST": "_MOST_JOINT_DAMPING",
    "learning.sensing.two._evidence": "_evidence_of_two",
    "learning.sensing.edges._evidence": "_evidence_of_edges",
    "control.reach.reach_map._AT_BOUND": "_MAP_AT_BOUND",
    "control.reach.drag._AT_BOUND": "_DRAG_AT_BOUND",
    "control.reach.reachable._LEAST_PROGRESS": "_LEAST_SHARE_OF_LENGTH",
    "control.reach.drag._LEAST_PROGRESS": "_LEAST_DRAG",
    "control.reach.reachable._SHORTEST_STEP": "_SHORTEST_SEARCH_STEP",
    "control.reach.drag._SHORTEST_STEP": "_SHORTEST_EDGE_STEP",
    "control.shape.newton_step._FLAT_CURVATURE": "_FLAT_TO_NEWTON",
    "control.shape.shape._FLAT_CURVATURE": "_OPEN_FREEDOM",
    "report.confidence._PLACES": "_BAND_PLACES",
    "report.modulus._PLACES": "_MODULUS_PLACES",
    "report.figures.style.colour": "hue_of",
    "report.figures.recordings._EDGED": "_EDGED_WIDE",
    "report.figures.checking._EDGED": "_EDGED_NARROW",
    "report.figures.recordings._spans": "_flagged_spans",
    "report.figures.checking._spans": "_push_spans",
    "report.figures.shaping.SNAPSHOTS": "PATH_SNAPSHOTS",
    "report.figures.reaching._arrow": "_reach_arrow",
    "report.figures.shaping._arrow": "_force_arrow",
    "export.table.PLACES": "TABLE_PLACES",
    "terminal.reaching._sureness": "_sureness_of_goal",
    "terminal.shaping._sureness": "_sureness_of_shape",
    "terminal.long_runs.MOST": "MOST_ROWS",
    "capture.devices.growing_bag.LONG_AGO": "SILENT_TOPIC",
    "capture.devices.lines.SILENT": "SILENT_LINE",
    "capture.devices.packages.SILENT": "SILENT_PACKAGE",
    "capture.devices.inputs.TIMING": "INPUT_TIMING",
    "capture.devices.realsense.TIMING": "REALSENSE_TIMING",
    "population.outliers.FEWEST": "FEWEST_OBJECTS",
    "population.shares.FEWEST": "FEWEST_GROUPS",
    "population.shares.HEAVY": "HEAVY_SHARES",
    "lab.random_beams.GROWTH": "FORCE_GROWTH",
    "lab.random_beams.PLACES": "DRAWN_PLACES",
    "lab.extensible.MOST_ITERATIONS": "MOST_NEWTON_STEPS",
    "lab.film_request.SLOW": "SLOW_PUSH",
    "report.figures.parts.MM": "MM_PER_M",
}
ALIAS: dict[str, str] = {
    "learning.live.stiffness_hyperparameters.SPREAD": "PRIOR_SPREAD",
    "cli.making.Design": "BeamDesign",
    "cli.reproducing.summary_of": "study_summary_of",
}
WINGS = ("live", "many", "lab", "studio")
PACKAGES = ("report.page",)
# folders whose names go: where their public names are afterwards
PKG_MOVE = {
    "streaming": "live",
    "capture": "live",
    "forecast": "lab",
    "batch": "many",
    "population": "many",
    "studies": "lab",
    "design": "learning",
    "paper": "learning",
}
FACADES = ("design", "paper")
# definitions that leave their module, with all that only they use
SPLIT = {
    "cli": {"cli.place": ["Place"]},
    "cli.long_runs": {"cli.reproducing": ["reproduce"]},
    "cli.recordings": {"cli.recording_live": ["record"]},
    "cli.control": {"cli.looping": ["loop"]},
    "terminal.long_runs": {"terminal.reproducing": ["show_reproduced"]},
    "terminal.recordings": {"terminal.recording_live": ["RecordingView"]},
}
DOC: dict[str, str] = {
    "live": "k(s) while a beam is pushed: cameras and force sensors, a recorder, and a learner that follows frame by frame.",
    "many": "Many beams: recordings learned one by one on all cores, and what they say of the populations they are from.",
    "studio": "A local page for one person: recordings, learning, and the learned beam to bend.",
}
NO_COMMENT: set[str] = set()
# patterns under the root -> a folder; the depth stays the same, so that paths relative to a file hold
TEST_MOVE: dict[str, str] = {
    "tests/capture/devices/*.py": "tests/live/devices/",
    "tests/capture/*": "tests/live/",
    "tests/streaming/*": "tests/live/",
    "tests/learning/live/*": "tests/live/learner/",
    "tests/learning/streamed.py": "tests/live/streamed_recording.py",
    "tests/batch/*": "tests/many/",
    "tests/population/test_command.py": "tests/many/test_population_command.py",
    "tests/population/*": "tests/many/",
    "tests/forecast/*": "tests/lab/",
    "tests/studies/*": "tests/lab/",
    # checks of the core on the lab's virtual benches, or together with the live learner
    "tests/control/loop/test_felt.py": "tests/lab/core/",
    "tests/learning/criticism/test_criticism.py": "tests/lab/core/",
    "tests/learning/inference/test_push_errors.py": "tests/lab/core/",
    "tests/learning/model/test_force_error.py": "tests/lab/core/",
    "tests/learning/model/test_frames.py": "tests/lab/core/",
    "tests/recording/clock/test_load_errors.py": "tests/lab/core/",
    "tests/recording/clock/test_several_pushes.py": "tests/lab/core/",
    "tests/recording/clock/test_span_moments.py": "tests/lab/core/",
    "tests/recording/force/test_load_stages.py": "tests/lab/core/",
    "tests/recording/test_attacked.py": "tests/lab/",
    "tests/recording/test_implausible_axes.py": "tests/lab/",
    "tests/learning/model/test_nuisance_sds.py": "tests/live/learner/",
    "tests/learning/model/test_tag_jacobian.py": "tests/live/learner/",
}

PATCH = {
    "pyproject.toml": [
        ("[tool.ruff.lint.mccabe]", "[tool.ruff.lint.isort]\ncombine-as-imports = true\n\n[tool.ruff.lint.mccabe]")
    ],
    "src/onebend/lazy.py": [
        (
            "def lazy_names(",
            '''WINGS = ("live", "many", "lab", "studio")  # folders that may be left out, each with commands of its own


def wings() -> list[str]:
    """The wings that are here."""
    return [name for name in WINGS if (Path(__file__).parent / name / "__init__.py").is_file()]


def lazy_names(''',
        ),
        ("from importlib import import_module\n", "from importlib import import_module\nfrom pathlib import Path\n"),
        ("    module: str  # in this folder\n", "    module: str\n"),
    ],
    "src/onebend/cli/__init__.py": [
        ('import_module(f"onebend.cli.{self.place.module}")', "import_module(self.place.module)"),
        (
            """        self.commands = {name: Command(name, place) for name, place in COMMANDS.items()}""",
            """        self.commands = {name: Command(name, place) for name, place in all_commands().items()}""",
        ),
        (
            "\nclass Command(TyperCommand):",
            '''
def all_commands() -> dict[str, Place]:
    """The commands of the core, and those that the wings which are here bring."""
    brought = [import_module(f"onebend.{wing}").COMMANDS for wing in wings()]
    return {name: place for table in (COMMANDS, *brought) for name, place in table.items()}


class Command(TyperCommand):''',
        ),
        ("from onebend.lazy import Place", "from onebend.lazy import Place, wings"),
        ("from dataclasses import dataclass\n", ""),
    ],
    "src/onebend/__init__.py": [
        (re.compile(r'        inside="([^"]+)"'), r'        inside=" ".join(("\1", *wings()))'),
        ("import lazy_names", "import lazy_names, wings"),
    ],
    "src/onebend/live/review.py": [
        (
            """    for time, corners in zip(later.time, later.corners, strict=True):
        logged = logged_at(log, known.reader, time, known.reader.stands_in(later.ahead))
        teach(known.learner, known.reader, time, corners, logged)
""",
            """    for when, corners in zip(later.time, later.corners, strict=True):
        logged = logged_at(log, known.reader, when, known.reader.stands_in(later.ahead))
        teach(known.learner, known.reader, when, corners, logged)
""",
        )
    ],
    "tests/live/devices/test_v4l2.py": [
        (re.compile(r"\bfrom onebend.live import cameras\b"), "from onebend.live import cameras as v4l2"),
        (re.compile(r"\bcameras\."), "v4l2."),
    ],
    "tests/test_blas.py": [
        ("onebend.live.OnlineLearner", "OnlineLearner"),
        ("import onebend\n", "import onebend\nfrom onebend.live import OnlineLearner\n"),
    ],
    "src/onebend/many/*.py": [
        ('"onebend.batch", "page.html"', '"onebend.many", "batch.html"'),
        ('"onebend.population", "page.html"', '"onebend.many", "population.html"'),
        ('"onebend.many", "page.html", {}', '"onebend.many", "batch.html", {}'),
        ('"onebend.many", "page.html", figures', '"onebend.many", "population.html", figures'),
    ],
    "src/onebend/lab/*.py": [
        ('"onebend.studies", "page.html"', '"onebend.lab", "study.html"'),
        ('"onebend.lab", "page.html"', '"onebend.lab", "study.html"'),
    ],
}
