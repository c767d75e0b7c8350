"""``duplex review``: prints a session's summary and events, and shows it where something happened."""

from collections.abc import Sequence

from recordings.quality.figures import report
from recordings.quality.without_truth import truth_free_figures
from recordings.session import Session
from viewer_app.errors import UsageError
from viewer_app.options.sessions import ReviewOptions
from viewer_app.output_console import output_console
from viewer_app.output_files import check_outputs, check_page, write_text
from viewer_app.report.events import ListedEvent, list_events, opening_event, seconds_of
from viewer_app.report.pages.good_part import MOST_STRETCHES, good_seconds
from viewer_app.report.terminal import print_damage, print_events, print_lines, print_summary, say_more
from viewer_app.viewer.viewer_choice import NoViewer, choose_viewing


def run(options: ReviewOptions) -> None:
    """Runs the command."""
    console = output_console()
    viewing = choose_viewing(options, options.session, live=False)
    check_outputs([options.html], [options.session], options.force)
    check_page(options.html)
    session = Session.open(options.session)
    events = list_events(session.events)
    at_ns, where = opening_time(options, session, events)
    print_damage(console, session)
    figures = report(session)
    if options.verbose or options.html is not None:
        figures["without_truth"] = truth_free_figures(session)
    if options.html is not None:
        from viewer_app.report.pages.review_page import review_page

        write_text(options.html, review_page(session, figures), options.force)
    print_summary(console, figures, verbose=options.verbose)
    print_lines(console, [good_seconds(session, None if options.verbose else MOST_STRETCHES)])
    if events or session.damage is None:
        print_events(console, events, all_of_them=options.verbose)
    else:
        console.print("Its events are lost. To find them again: duplex replay SESSION.rrd --save NEW.rrd.")
    if options.html is not None:
        console.print(f"Wrote {options.html}.", markup=False, soft_wrap=True)
    elif not options.verbose:
        say_more(console, "every bone, with plots, with --html FILE.html")
    if viewing == NoViewer():  # none is wanted
        return
    from viewer_app.report.pages.session_page import session_page  # Rerun
    from viewer_app.viewer.file_window import in_this_layout, served, show

    in_layout = in_this_layout(
        session, options.session, session_page(session.last_setup, figures), options.layout
    )
    if viewing.hub is not None:
        with in_layout as file, served(file, viewing.hub):
            viewing.announce(console)
            console.print(f"Move its time cursor by hand; a window would open {where}.", markup=False)
            viewing.stay(console)
    elif isinstance(viewing, NoViewer):
        console.print(f"{viewing.why_not}; a viewer would open {where}.", markup=False)
    else:
        console.print(f"The viewer opens {where}.", markup=False)
        with in_layout as file:
            stands_there = show(file, at_ns)
        if not stands_there:
            console.print("The viewer did not accept the time; move its time cursor by hand.", style="yellow")


def opening_time(options: ReviewOptions, session: Session, events: Sequence[ListedEvent]) -> tuple[int, str]:
    """Where the viewer opens: ns since the first pair, and the same in words."""
    if options.event is not None and options.at is not None:
        raise UsageError("--event and --at both say where to open; give only one.")
    if options.at is not None:
        last_s = int(session.time_ns[-1]) * 1e-9
        if not 0.0 <= options.at <= last_s:
            raise UsageError(f"--at {options.at:g}: the session runs from 0 to {last_s:.2f} s.")
        return round(options.at * 1e9), f"at {options.at:.2f} s"
    if options.event is not None:
        if not 1 <= options.event <= len(events):
            known = f"they are numbered from 1 to {len(events)}" if events else "the session has none"
            raise UsageError(f"--event {options.event}: no such event; {known}.")
        chosen: ListedEvent | None = events[options.event - 1]
    else:
        chosen = opening_event(events, session.first_calibrated_frame or 0)
    if chosen is None:
        return 0, "at the beginning: no later event calls for a look"
    time_ns = chosen.event.time_ns
    return time_ns, f"at {seconds_of(time_ns)}, event {chosen.number}"
