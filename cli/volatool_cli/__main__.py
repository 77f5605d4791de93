"""``python -m volatool_cli``."""

from volatool_cli.main import main

main()
