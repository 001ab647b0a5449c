"""The plot of a training run's curves."""

import pytest

from benchmarks.curves import charts, main, read_curves
from hybrid.errors import DataError

ROWS = "passes,train_uv,train_scale,test_bent_percent,test_upright\n1000,0.5,-3,4,0.1\n2000,0.25,-4,2,0.2\n"


def test_curves_of_losses_and_of_errors(tmp_path):
    path = tmp_path / "curves.csv"
    path.write_text(ROWS)
    losses, errors = charts(read_curves(path))
    assert [p.name for p in losses.points] == ["uv"]  # the negative one has no logarithm
    assert [(p.name, p.xy) for p in errors.points] == [("bent", ((1.0, 4.0), (2.0, 2.0)))]
    assert main([str(path), "--picture", str(tmp_path / "curves.png")]) == 0
    assert (tmp_path / "curves.png").stat().st_size > 1000


@pytest.mark.parametrize("text", ["", "passes,train_uv\n", "passes,train_uv\n1,two\n", "epoch\n1\n"])
def test_other_files_are_refused(tmp_path, text, capsys):
    path = tmp_path / "curves.csv"
    path.write_text(text)
    with pytest.raises(DataError):
        read_curves(path)
    assert main([str(path)]) == 1
    assert "curves.csv" in capsys.readouterr().err
