"""What every page shares: the folder, its jobs, the frame around a page, and the card of a job."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, urlencode

from nicegui import app, ui

from femu_piezo.errors import InputError
from femu_piezo.web.drafts import Draft
from femu_piezo.web.jobs import Job, Jobs
from femu_piezo.web.workspace import LARGEST_UPLOAD, Workspace

PAGES = {
    "sweep": "Sweep",
    "specimen": "Specimen",
    "update": "Update",
    "diagnosis": "Diagnosis",
    "modes": "Modes",
    "lot": "Lot",
    "export": "Export",
}
"""Pages by their address, in the order in which they are used."""

#: Text and grid of charts on a dark page, and what marks the focus of the keyboard.
_STYLE = """
.body--dark .js-plotly-plot text { fill: #e0e0e0 !important; }
.body--dark .nicegui-link { color: #90caf9; }
body:not(.body--dark) .nicegui-link { color: #0d47a1; }
header a { color: white !important; }
.error { color: #b3261e; }
.body--dark .error, .body--dark .q-field__messages { color: #ff8a80; }
:focus-visible { outline: 3px solid #e69f00 !important; outline-offset: 2px; }
@layer theme {
  .body--dark .text-negative { color: #ff8a80 !important; }
  .body--dark .q-field .text-primary { color: #90caf9 !important; }
}
.q-table th, .q-table td { font-variant-numeric: tabular-nums; }
.answer { border-left: 4px solid #0072b2; padding-left: 0.75rem; }
"""
_NAME_BUTTON = "document.querySelectorAll('.q-uploader a').forEach(a => a.setAttribute('aria-label', 'choose files'))"
_PRIMARY = "#0d47a1"
_DARK = {"auto": None, "light": False, "dark": True}
_POLL = 0.4


@dataclass(frozen=True)
class Site:
    """A folder and its queue."""

    workspace: Workspace
    jobs: Jobs

    def draft(self, name: str) -> Draft:
        """Unsaved edits of a specimen file in this browser."""
        return Draft(self.workspace, name, app.storage.browser["id"])

    def address(self, name: str) -> str:
        """Where the browser finds a file of the folder."""
        return f"/files/{quote(name)}"

    @contextmanager
    def frame(self, page: str, chosen: Mapping[str, str]) -> Iterator[None]:
        """Header with links to all pages, and the content below; `chosen` : query of the address, kept in links."""
        ui.add_css(_STYLE)
        ui.colors(primary=_PRIMARY)
        wish = app.storage.user.get("theme", "auto")
        dark = ui.dark_mode(_DARK[wish])
        ui.page_title(f"{PAGES[page]} · femu-piezo")
        query = urlencode({key: value for key, value in chosen.items() if value})
        with ui.header().classes("items-center gap-x-4 gap-y-0 px-4 py-2 flex-wrap"):
            ui.label("femu-piezo").classes("text-lg font-bold")
            with ui.element("nav").props('aria-label="pages"').classes("flex flex-wrap gap-x-1"):
                for key, title in PAGES.items():
                    link = ui.link(title, f"/{key}" + (f"?{query}" if query else ""))
                    link.classes("px-2 py-2 no-underline rounded" + (" bg-white/25 font-bold" if key == page else ""))
                    if key == page:
                        link.props('aria-current="page"')
            ui.space()
            self._queue()

            def turn() -> None:
                following = list(_DARK)[(list(_DARK).index(app.storage.user.get("theme", "auto")) + 1) % len(_DARK)]
                app.storage.user["theme"], dark.value = following, _DARK[following]
                button.text = f"theme: {following}"

            button = ui.button(f"theme: {wish}", on_click=turn).props("flat color=white no-caps dense")
        ui.add_head_html('<script>document.documentElement.lang = "en"</script>')
        with ui.element("div").classes("w-full max-w-screen-xl mx-auto flex flex-col gap-4 p-2"):
            ui.label(PAGES[page]).props('role="heading" aria-level="1"').classes("text-2xl font-bold")
            yield

    def _queue(self) -> None:
        """A list of the latest jobs, which a button of the header opens."""
        with ui.button().props("flat color=white no-caps dense") as button, ui.menu().props("max-width=90vw"):
            rows = ui.column().classes("p-4 min-w-72 gap-2")
        shown: list[object] = []

        def tell() -> None:
            jobs = self.jobs.all()[:12]
            active = sum(job.active for job in jobs)
            button.text = f"jobs: {active} active" if active else "jobs"
            state = [(job.number, job.state) for job in jobs]
            if state == shown:
                return
            shown[:] = state
            rows.clear()
            with rows:
                if not jobs:
                    ui.label("Nothing has been computed here yet.")
                for job in jobs:
                    with ui.row().classes("items-center gap-2 no-wrap"):
                        ui.label(f"{job.command} {job.source}: {job.state}").classes("grow")
                        if job.active:
                            cancel = ui.button("Cancel", color=None)
                            cancel.on_click(lambda number=job.number: self.jobs.cancel(number))
                            cancel.props("flat dense no-caps")

        ui.timer(_POLL, tell)

    def job_card(
        self,
        command: str,
        source: str,
        words: str,
        done: Callable[[], None],
        arguments: Callable[[], Sequence[str]] = tuple,
        check: Callable[[], object] | None = None,
    ) -> None:
        """A button that queues a command, then its progress with the time left, a way to cancel, and its error.

        Parameters
        ----------
        words : of the button
        done : called when the command has ended; a lot without any result has a table of the reasons
        arguments : further arguments of the command line, called at the request
        check : raises InputError where the command cannot be run
        """
        with ui.card().classes("w-full"):
            with ui.row().classes("items-center gap-4 w-full"):
                start = ui.button(words).props("no-caps")
                state = ui.label().props('role="status" aria-live="polite"').classes("grow")
                cancel = ui.button("Cancel", color=None).props("flat no-caps")
            bar = ui.linear_progress(show_value=False).props('indeterminate aria-label="running"')
        seen: dict[str, object] = {}

        def ask() -> None:
            try:
                if check is not None:
                    check()
                self.jobs.ask(command, source, self.workspace.results(source, command), arguments())
            except InputError as error:
                tell_error(state, str(error))
                seen["said"] = True
                return
            seen.pop("said", None)
            tell()

        def tell() -> None:
            job = self.jobs.latest(command, source)
            active = job is not None and job.active
            start.set_enabled(not active)
            cancel.set_visibility(active)
            bar.set_visibility(active)
            if job is not None and not seen.get("said"):
                state.text = self._words(job)
                state.classes(replace="grow" + (" error" if job.state == "failed" else ""))
            was = seen.get("was")
            now = None if job is None else (job.number, job.state)
            if was is not None and was != now and job is not None and job.state in ("done", "failed"):
                done()
            seen["was"] = now or "none"

        def stop() -> None:
            job = self.jobs.latest(command, source)
            if job is not None:
                self.jobs.cancel(job.number)
                tell()

        start.on_click(ask)
        cancel.on_click(stop)
        tell()
        ui.timer(_POLL, tell)

    def _words(self, job: Job) -> str:
        """The state of a job in one line."""
        if job.state == "waiting":
            before = sum(one.active and one.number < job.number for one in self.jobs.all())
            return f"waiting for {before} other{'s' if before > 1 else ''}" if before else "waiting"
        if job.state == "running":
            left = self.jobs.seconds_left(job)
            rest = "a little longer than the last time" if left is None else f"about {_seconds(left)} left"
            return f"{job.step or 'starting'} … {_seconds(job.seconds)}, {rest}"
        if job.state == "failed":
            return job.message
        if job.state == "cancelled":
            return f"cancelled{': ' + job.message if job.message else ''}"
        return f"done in {_seconds(job.seconds)}"

    def choose(self, names: Sequence[str], chosen: str, words: str, page: str, key: str) -> None:
        """A list to choose one from; the choice becomes part of the address, so that it stays after a reload."""

        def go(event) -> None:
            ui.navigate.to(f"/{page}?{urlencode({key: event.value})}")

        ui.select(list(names), value=chosen or None, label=words, on_change=go).props("outlined").classes(
            "w-full max-w-md"
        )

    def specimen_field(self, spec: str, page: str, chosen: Mapping[str, str]) -> str:
        """Show the choice of a specimen file; the name of the chosen one, "" where the page has none to work with.

        A file that is named but not saved yet is reported, and no other is shown in its place.
        """
        names = self.workspace.specimens()
        spec = spec or (names[0] if names else "")
        self.choose(names, spec if spec in names else "", "Specimen", page, "spec")
        if not spec:
            nothing(
                "This folder has no specimen file yet: choose a sweep on its page, and describe its specimen there."
            )
        elif spec not in names:
            ui.label(f"{spec} is not saved yet; the commands work with saved files.").props('role="alert"')
            ui.link("see it, and save it", f"/specimen?{urlencode({**chosen, 'spec': spec})}")
            return ""
        return spec

    def page_of_specimen(self, page: str, build: Callable[[str], None]) -> None:
        """Give a page that works with one specimen file its address; `build` gets the name of the file."""

        @ui.page(f"/{page}")
        def shown(spec: str = "", file: str = "") -> None:
            with self.frame(page, {"spec": spec, "file": file}):
                spec = self.specimen_field(spec, page, {"file": file})
                if spec:
                    build(spec)

    def age(self, spec: str, result: Path) -> None:
        """Warn where the specimen file or a file that it names is newer than a result."""
        try:
            files = [path for one in self.workspace.specimen(spec) for path in one.files]
            newest, then = max(path.stat().st_mtime for path in files), result.stat().st_mtime
        except (InputError, OSError, ValueError):
            return
        if newest > then:
            words = (
                "These are the results of an earlier state: the specimen or its sweep has changed since. Run it again."
            )
            ui.label(words).classes("error").props('role="alert"')

    def drop(self, words: str, taken: Callable[[list[str]], None]) -> None:
        """A place to drop files on; `taken` gets the names under which they are kept."""

        async def keep(event) -> None:
            try:
                content = await event.file.read()
                name = self.workspace.take(event.file.name, content)
            except InputError as error:
                complain(str(error))
                return
            taken([name])

        def refuse() -> None:
            text = f"the file is larger than the {LARGEST_UPLOAD / 1e6:.0f} MB allowed; is this the right file?"
            complain(text)

        upload = ui.upload(
            label=words,
            multiple=True,
            auto_upload=True,
            max_file_size=LARGEST_UPLOAD,
            on_upload=keep,
            on_rejected=refuse,
        )
        upload.props("flat bordered").classes("w-full max-w-md").style("min-height: 7rem")
        button = ui.button("Choose files", color=None, on_click=lambda: upload.run_method("pickFiles"))
        button.props("no-caps outline")
        # the field's own button is a bare icon
        ui.timer(0.5, lambda: ui.run_javascript(_NAME_BUTTON), once=True)


def tell_error(label: ui.label, sentence: str) -> None:
    """Show an error in the label of its place."""
    label.text = sentence
    label.classes(add="error")


def complain(sentence: str) -> None:
    """Show an error that belongs to no place on the page; it stays until it is closed."""
    ui.notify(sentence, type="negative", close_button=True, timeout=0)


def nothing(words: str) -> None:
    """Show a sentence in place of results that do not exist yet."""
    ui.label(words).classes("opacity-80")


def missing(words: str) -> None:
    """Tell that what the address names is not in the folder; no other is shown in its place."""
    ui.label(words).classes("error").props('role="alert"')


def table(
    headings: Sequence[str], rows: Sequence[Sequence[object]], label: str, at_once: int | None = None
) -> ui.table:
    """A table whose columns sort by their numbers where they have some; of more than `at_once` rows it has pages."""
    columns = [
        {"name": str(k), "label": heading, "field": str(k), "sortable": True, "align": _align([row[k] for row in rows])}
        for k, heading in enumerate(headings)
    ]
    records = [{"id": n, **{str(k): cell for k, cell in enumerate(row)}} for n, row in enumerate(rows)]
    pages = at_once if at_once is not None and len(rows) > at_once else None
    found = ui.table(columns=columns, rows=records, row_key="id", pagination=pages)
    return found.props(f'flat bordered dense aria-label="{label}"').classes("w-full")


def _align(cells: Sequence[object]) -> str:
    """Numbers to the right, words to the left."""
    words = [str(cell).lstrip("-+−") for cell in cells if cell not in ("", "-")]
    return "right" if words and all(word[:1].isdigit() for word in words) else "left"


def _seconds(value: float) -> str:
    return f"{value:.0f} s" if value < 90 else f"{value / 60:.1f} min"
