"""``duplex export``: writes S* in formats of other programs."""

from recordings.export import export, writer_for
from recordings.session import Session
from viewer_app.options.sessions import ExportOptions
from viewer_app.output_console import output_console
from viewer_app.output_files import check_outputs, export_files
from viewer_app.report.pages.good_part import good_frames_of
from viewer_app.report.terminal import print_damage


def run(options: ExportOptions) -> None:
    """Runs the command."""
    console = output_console()
    write = writer_for(options.to, options.table, options.rate, options.names, options.feet, options.sigma)
    check_outputs(export_files(options.to), [options.session], options.force)
    session = Session.open(options.session)
    print_damage(console, session)
    if options.good:
        session = session.part(good_frames_of(session, console))
    written = export(session, options.to, write, options.force)
    console.print(f"Wrote {options.to}: {written}.", markup=False, soft_wrap=True)
    if never := session.never_seen:
        guessed = options.to.suffix.lower() in (".bvh", ".glb", ".npz")
        places = "places guessed by the bones" if guessed else "no places"
        line = f"No sensor ever saw {', '.join(never)}: the file has {places} there."
        console.print(line, markup=False, soft_wrap=True)
