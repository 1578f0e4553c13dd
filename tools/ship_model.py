"""Put a trained model into the package, its matrices in half precision: `CovarianceEstimator.load` finds it by name."""

import argparse
from pathlib import Path

from pointnetkl.models import model_file
from pointnetkl.workflow import artifacts

WEIGHTS = Path(model_file.__file__).parents[1] / "weights"


def main() -> None:
    """Write the file, and say how large it is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path, help="its file, such as models/pointnetkl.pt; the name stays")
    path = parser.parse_args().model
    content = model_file.halved(model_file.read(path))
    artifacts.write_bytes(WEIGHTS / path.name, content)
    print(f"{WEIGHTS / path.name}: {len(content):,} bytes")


if __name__ == "__main__":
    main()
