"""``python -m volatool_cli``."""

from volatool_cli.main import main

if __name__ == "__main__":  # not in worker processes, which import this module too
    main()
