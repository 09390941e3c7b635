import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import FileError
from hapticnet.tables import Table, read_csv, write_csv

finite = st.floats(allow_nan=False, allow_infinity=False)


@pytest.fixture
def table_of(tmp_path):
    def read(content: str | bytes) -> Table:
        path = tmp_path / "file.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_csv(path)

    return read


def test_columns_are_had_by_name_and_by_number_from_0(table_of):
    table = table_of("t_s,force_n\n0,1.5\n0.001,-2e-3\n")
    assert table.names == ("t_s", "force_n")
    assert len(table) == 2
    assert table.column("force_n").tolist() == [1.5, -0.002]
    assert table.column("1").tolist() == [1.5, -0.002]
    assert table.column("t_s").dtype == np.float64


def test_a_file_without_a_header_has_its_columns_numbered(table_of):
    table = table_of("1,2\n3,4\n")
    assert table.names == ("0", "1")
    assert table.column("0").tolist() == [1.0, 3.0]


def test_a_name_wins_over_a_number(table_of):
    assert table_of("1,a\n5,6\n").column("1").tolist() == [5.0]


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbfa,b\n1,2\n3,4",
        b"a,b\r\n1,2\r\n3,4\r\n",
        b"a,b\r1,2\r3,4\r",
        b"# rig 7\na,b\n1,2\n# pause, long\n3,4\n",
        b"\n\na,b\n1,2\n   \n3,4\n\n\n",
        b"a, b \n 1 ,2\n3,\t4\n",
        b'"a","b"\n"1","2"\n"3","4"\n',
        "# Kräfte\na,b\n1,2\n3,4\n".encode(),
    ],
    ids=["BOM", "CRLF", "CR", "comments", "blank lines", "spaces", "quotes", "UTF-8"],
)
def test_what_programs_write_around_the_numbers_is_tolerated(table_of, content):
    table = table_of(content)
    assert table.names == ("a", "b")
    assert table.column("a").tolist() == [1.0, 3.0]
    assert table.column("b").tolist() == [2.0, 4.0]


def test_text_columns_do_no_harm_until_they_are_asked_for(table_of):
    table = table_of('t_s,state,force_n\n0,"free, far",0\n1,contact,2\n')
    assert table.column("force_n").tolist() == [0.0, 2.0]
    with pytest.raises(FileError, match=r'file\.csv, line 2, column "state": "free, far" is not a finite number'):
        table.column("state")


@pytest.mark.parametrize("cell", ["", "abc", "nan", "-inf", "1e999", "0x10", "1_000", "1;2", "1 2", "--1", "1\x00"])
@pytest.mark.parametrize("clean_rows", [0, 5000])
def test_the_first_bad_cell_is_named_by_line_and_column(table_of, cell, clean_rows):
    table = table_of("# comment\na,b\n" + "1,2\n" * clean_rows + f"\n3,{cell}\n4,worse\n")
    with pytest.raises(FileError, match=rf'file\.csv, line {clean_rows + 4}, column "b": .* is not a finite number'):
        table.column("b")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "there is nothing in it"),
        ("\n# only a comment\n", "there is nothing in it"),
        ("a,b\n", "there are no rows under the header"),
        ("a,b\n1,2\n3\n", "line 3: 1 cells; the first line has 2"),
        ("a,b\n1,2,3\n", "line 2: 3 cells; the first line has 2"),
        ("1,2\n3,4,5\n", "line 2: 3 cells; the first line has 2"),
        ('a\n1\n"2\n3\n', "line 3: a quote is opened and not closed"),
        ('a,b\n"1\n3",4\n5,6\n', "line 2: a quote is opened and not closed"),
        ("a\n" + "x" * 200_000, "line 2: field larger than field limit"),
        (b"a\n1\n\xff\xfe\n", "line 3: not UTF-8 text"),
    ],
)
def test_a_malformed_file_is_refused_with_the_line(table_of, content, message):
    with pytest.raises(FileError, match=message):
        table_of(content)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(FileError, match=r"none\.csv: No such file"):
        read_csv(tmp_path / "none.csv")
    with pytest.raises(FileError, match="Is a directory"):
        read_csv(tmp_path)


def test_a_missing_column_lists_what_there_is(table_of):
    with pytest.raises(FileError, match='no column "force"; there are t_s, force_n'):
        table_of("t_s,force_n\n1,2\n").column("force")
    with pytest.raises(FileError, match=r'no column "2".*numbers 0 to 1'):
        table_of("t_s,force_n\n1,2\n").column("2")


def test_a_name_that_stands_twice_is_ambiguous(table_of):
    table = table_of("a,a\n1,2\n")
    with pytest.raises(FileError, match='2 columns are called "a"'):
        table.column("a")
    assert table.column("1").tolist() == [2.0]


@given(rows=st.lists(st.tuples(finite, finite), min_size=1))
def test_what_is_written_is_read_back_bit_for_bit(tmp_path_factory, rows):
    path = tmp_path_factory.getbasetemp() / "round_trip.csv"
    first, second = [list(column) for column in zip(*rows, strict=True)]
    write_csv(path, {"t_s": first, "force, N": np.array(second)})
    table = read_csv(path)
    assert table.names == ("t_s", "force, N")
    for name, written in (("t_s", first), ("force, N", second)):
        read = table.column(name).tolist()
        assert [(value, math.copysign(1.0, value)) for value in read] == [
            (value, math.copysign(1.0, value)) for value in written
        ]


@given(st.text(alphabet="019.,-+e_ #\"\n\r\tna\x00;'µ"))
def test_any_text_gives_finite_columns_or_a_file_error(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(("a,b\n1,2\n" + text).encode())
    try:
        table = read_csv(path)
        columns = [table.column("a"), table.column("b")]
    except FileError:
        return
    # The last row stands where the table says it does, so that no line was merged or lost on the way.
    lines = path.read_bytes().decode().replace("\r\n", "\n").replace("\r", "\n").split("\n")
    last_line = lines[table.line_of(len(table) - 1) - 1]
    assert [float(cell.strip().strip('"')) for cell in last_line.split(",")] == [column[-1] for column in columns]
    assert all(np.isfinite(column).all() and len(column) == len(table) for column in columns)


def test_a_folder_that_does_not_exist_is_refused_when_writing(tmp_path):
    with pytest.raises(FileError, match="No such file"):
        write_csv(tmp_path / "none" / "out.csv", {"a": [1.0]})


def test_columns_of_unequal_length_are_refused(tmp_path):
    with pytest.raises(ValueError, match="unequal length"):
        write_csv(tmp_path / "out.csv", {"a": [1.0, 2.0], "b": [1.0]})
    assert not (tmp_path / "out.csv").exists()
