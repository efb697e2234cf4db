"""Makes a store of recorded runs, or completes it: what exists already is neither read nor computed again."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader

from embodied_depth_trainer.cluster import LOCAL
from embodied_depth_trainer.data.teacher_options import TeacherOptions
from embodied_depth_trainer.store.arrays import ArrayFolder, DamagedError
from embodied_depth_trainer.store.chain import breaks
from embodied_depth_trainer.store.complete import CompleteRuns
from embodied_depth_trainer.store.known_robots import KnownRobots
from embodied_depth_trainer.store.labels import LabelJob, halo, labels_name, make_labels
from embodied_depth_trainer.store.manifest import Entry, Run
from embodied_depth_trainer.store.parts import Part
from embodied_depth_trainer.store.plan import OpenRuns, Plan
from embodied_depth_trainer.store.pool import Pool, pool
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.shards import ShardJob, make_shard
from embodied_depth_trainer.store.sources import RecordedRun, RecordedSegment, RemoteSegment, find_runs
from embodied_depth_trainer.store.store import Names, Store
from embodied_depth_trainer.store.trust import is_decided, review
from embodied_depth_trainer.store.version import read_version

# The labels of a segment by the name of its file.
NamedJob = tuple[str, LabelJob]


@dataclass(frozen=True)
class Tools:
    """What the recipe needs besides the recordings."""

    recipe: Recipe
    robot: Path | None = None
    """Path of firmware-host."""
    teacher: Path | None = None
    teacher_options: TeacherOptions | None = None
    workers: int = 1
    """Number of processes."""
    known_robots: KnownRobots | None = None
    """The robots whose segments are accepted; `None`: signatures are not checked."""
    on: str = LOCAL
    """Where the processes are; see `cluster.place`. On a cluster, all paths must be absolute."""


@dataclass
class Report:
    """What a call has done."""

    segments: int = 0
    """Number of segments whose shards were made or found."""
    labelled: int = 0
    """Number of shards whose labels were computed."""
    damaged: dict[str, str] = field(default_factory=dict)
    """Segments that end early or cannot be read, and why."""
    signed_by: Counter[str] = field(default_factory=Counter)
    """Number of new segments that each known robot signed, by its public key."""
    refused: dict[str, str] = field(default_factory=dict)
    """Segments that no known robot signed, and why nothing is trained on them."""
    breaks: list[str] = field(default_factory=list)
    """Signed segments that do not follow the one before."""
    replaced: list[str] = field(default_factory=list)
    """Objects that were replaced after they had been listed, and are left for the next call."""


def prepare(sources: Sequence[Path | str], store: Store, tools: Tools, growing: bool = False) -> Report:
    """Makes what is missing of all runs below the sources, which are directories or URLs. While runs are `growing`, the
    last segment of each is left for later until it is complete."""
    report = Report()
    if tools.known_robots is not None:
        report.refused.update(review(store, tools.known_robots))
    shards, labels = plan(sources, store, tools, growing)
    with pool(tools.on, tools.workers, store.downloads) as workers:
        _make_shards(shards, store, tools, workers, report)
        if tools.recipe.labels:
            _make_labels(_completed(labels, shards, store, tools), store, workers, report)
    return report


def prepare_part(sources: Sequence[Path | str], store: Store, tools: Tools, part: Part) -> Report:
    """Makes the missing shards of a part of the segments, and no lists and no labels: a list would be written by all
    parts, and labels need the shards of neighbours. `prepare` makes both afterwards."""
    report = Report()
    shards, _ = plan(sources, store, tools, part=part)
    jobs = (
        ((source, segment), _shard_job(segment, store, tools)) for source, segments in shards for segment in segments
    )
    with pool(tools.on, tools.workers, store.downloads) as workers:
        for (source, segment), entry in workers.each(make_shard, jobs, shards.total, "segment"):
            _report(entry, source, segment, report)
    return report


def plan(
    sources: Sequence[Path | str], store: Store, tools: Tools, growing: bool = False, part: Part | None = None
) -> tuple[Plan[RecordedSegment], Plan[NamedJob]]:
    """What is to be done of all runs below the sources: segments whose shards are missing and, of runs whose shards are
    all there, labels that are missing. A `part` has no labels."""
    shards, labels = Plan[RecordedSegment](store.folder), Plan[NamedJob](store.folder)
    in_store = store.shard_names, store.labels_names
    complete = CompleteRuns(store, tools.known_robots, in_store)
    # A run below two sources is found twice.
    planned = set()
    for recorded in (run for source in sources for run in find_runs(source)):
        if (recorded.source, recorded.segments[0].name) in planned:
            continue
        planned.add((recorded.source, recorded.segments[0].name))
        state = complete.state(recorded)
        if complete.has(recorded, state):
            continue
        run = store.run_of(recorded.source)
        wanted = recorded.segments if part is None else part.of(recorded)
        missing = [segment for segment in wanted if not _is_prepared(segment, run, in_store[0], tools)]
        closed = [segment for segment in missing if not (growing and _is_open(segment, recorded))]
        if closed:
            shards.add(recorded.source, closed)
        elif part is None:
            unlabelled = _unlabelled(run, in_store[1], store, tools) if tools.recipe.labels else []
            labels.add(recorded.source, unlabelled)
            if not missing and not unlabelled:
                complete.add(recorded, state, run)
    complete.write()
    return shards, labels


def _completed(labels: Plan[NamedJob], shards: Plan[RecordedSegment], store: Store, tools: Tools) -> Plan[NamedJob]:
    """The plan of labels with those of the runs that have new shards."""
    changed = {source for source, _ in shards}
    both = Plan[NamedJob](store.folder)
    for source, jobs in labels:
        # An object store may list a run in several parts, of which one was complete.
        if source not in changed:
            both.add(source, jobs)
    in_store = store.labels_names
    for source in sorted(changed):
        both.add(source, _unlabelled(store.run_of(source), in_store, store, tools))
    return both


def _unlabelled(run: Run, in_store: Names, store: Store, tools: Tools) -> list[NamedJob]:
    """The segments of a run whose labels are missing, by their files' names."""
    found = []
    folders = store.folder / "shards", store.folder / "labels"
    shards = run.shards
    for place, entry in enumerate(shards):
        before, after = halo(shards, place)
        assert entry.shard is not None
        if entry.labels != labels_name(entry.shard, before, after) or entry.labels not in in_store:
            job = LabelJob(*folders, before, entry.shard, after, entry.labels, tools.teacher, tools.teacher_options)
            found.append((entry.file, job))
    return found


def remove_damaged(store: Store) -> list[str]:
    """Removes shards and labels whose digests are not those that were written, so that they are made again; returns
    what was wrong with each."""
    found = []
    for run in store.runs.values():
        for entry in run.shards:
            assert entry.shard is not None
            folders = [store.shard(entry.shard)]
            if entry.labels is not None:
                folders.append(store.labels(entry.labels))
            for folder in folders:
                try:
                    ArrayFolder(folder).check()
                except DamagedError as problem:
                    found.append(str(problem))
                    shutil.rmtree(folder, ignore_errors=True)
    return found


def _make_shards(plan: Plan[RecordedSegment], store: Store, tools: Tools, workers: Pool, report: Report) -> None:
    with OpenRuns(store) as lists:
        jobs = _shard_jobs(plan, lists, store, tools)
        for (source, segment), entry in workers.each(make_shard, jobs, plan.total, "segment"):
            _report(entry, source, segment, report)
            complete = lists.done(source, entry)
            if complete is not None:
                report.breaks += breaks(*complete)


def _shard_jobs(
    plan: Plan[RecordedSegment], lists: OpenRuns, store: Store, tools: Tools
) -> Iterator[tuple[tuple[str, RecordedSegment], ShardJob]]:
    for source, segments in plan:
        lists.begin(source, len(segments))
        for segment in segments:
            yield (source, segment), _shard_job(segment, store, tools)


def _shard_job(segment: RecordedSegment, store: Store, tools: Tools) -> ShardJob:
    shards = store.folder / "shards"
    return ShardJob(segment, shards, store.downloads, tools.recipe, tools.robot, tools.known_robots)


def _report(entry: Entry | None, source: str, segment: RecordedSegment, report: Report) -> None:
    """Reports what a job has made of a segment."""
    if entry is None:
        report.replaced.append(str(segment))
        return
    report.segments += 1
    # The review may have refused what was known of it.
    report.refused.pop(f"{source}/{entry.file}", None)
    if entry.refused is not None:
        report.refused[f"{source}/{entry.file}"] = entry.refused
    if entry.signed_by is not None:
        report.signed_by[entry.signed_by] += 1
    if entry.damage is not None:
        report.damaged[str(segment)] = entry.damage


def _is_prepared(segment: RecordedSegment, run: Run, in_store: Names, tools: Tools) -> bool:
    known = run.entries.get(segment.name)
    if known is None or not segment.is_known(known) or not is_decided(known, tools.known_robots):
        return False
    return known.shard is None or known.shard in in_store


def _is_open(segment: RecordedSegment, run: RecordedRun) -> bool:
    """Whether the robot may still write this segment: it is the last of its run and has no index yet. An object is
    complete."""
    if isinstance(segment, RemoteSegment) or segment != run.segments[-1]:
        return False
    with segment.file.open("rb") as stream:
        try:
            return make_reader(stream).get_summary() is None
        except McapError:
            return True


def _make_labels(plan: Plan[NamedJob], store: Store, workers: Pool, report: Report) -> None:
    with OpenRuns(store) as lists:
        for (source, file), name in workers.each(make_labels, _label_jobs(plan, lists), plan.total, "label"):
            lists.done(source, replace(lists.entry(source, file), labels=name))
            report.labelled += 1


def _label_jobs(plan: Plan[NamedJob], lists: OpenRuns) -> Iterator[tuple[tuple[str, str], LabelJob]]:
    for source, jobs in plan:
        lists.begin(source, len(jobs))
        for file, job in jobs:
            yield (source, file), job


def unlisted(store: Store) -> list[Path]:
    """Shards, labels and pairs that no list of segments and no frozen list names, and what a killed process left."""
    frozen = [kept for file in (store.folder / "frozen").glob("*.json") for kept in read_version(file).shards]
    shards = {kept.shard for kept in frozen}
    labels = {kept.labels for kept in frozen}
    for run in store.runs.values():
        shards.update(entry.shard for entry in run.shards if entry.shard is not None)
        labels.update(entry.labels for entry in run.shards)
    unused = [folder for folder in (store.folder / "shards").glob("*") if folder.name not in shards]
    unused += [folder for folder in (store.folder / "labels").glob("*") if folder.name not in labels]
    # A pair index is named by its shard and a key.
    unused += [folder for folder in (store.folder / "pairs").glob("*") if folder.name.rpartition("-")[0] not in shards]
    unused += store.downloads.glob("*")
    return unused


def prune(store: Store) -> int:
    """Removes what no list names; returns the number of folders."""
    folders = unlisted(store)
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)
    return len(folders)
