"""``python -m crankorder`` is the command line."""

from crankorder.cli import main

main(prog_name="crankorder")
