"""``duplex export``: writes S* in formats of other programs."""

from recordings.export import writer_for
from recordings.session import Session
from viewer_app.options.sessions import ExportOptions
from viewer_app.output_console import output_console
from viewer_app.output_files import check_outputs, whole_file
from viewer_app.report.terminal import print_damage


def run(options: ExportOptions) -> None:
    """Runs the command."""
    console = output_console()
    write = writer_for(options.to, options.table, options.rate, options.names)
    check_outputs([options.to], [options.session], options.force)
    session = Session.open(options.session)
    print_damage(console, session)
    with whole_file(options.to) as partial:
        written = write(session, partial)
    console.print(f"Wrote {options.to}: {written}.", markup=False, soft_wrap=True)
    if session.never_seen:
        left = "are guessed by their bones" if options.to.suffix in (".bvh", ".glb") else "are left empty"
        names = ", ".join(session.never_seen)
        console.print(f"No sensor ever saw {names}: they {left}.", markup=False, soft_wrap=True)
