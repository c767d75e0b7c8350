"""The option of the scenarios."""


def pytest_addoption(parser):
    parser.addoption(
        "--figures",
        action="store_true",
        help="test how fast the scenarios run, too; needs a machine that does nothing else, and -n 0",
    )
