import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.errors import FileError
from hapticnet.recordings.text import read_csv
from tests.recordings.session_cases import write_csv

finite = st.floats(allow_nan=False, allow_infinity=False)


@pytest.fixture
def table_of(tmp_path):
    def read(content, columns=None):
        path = tmp_path / "file.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return {name: values.tolist() for name, values in read_csv(path, columns).items()}

    return read


@pytest.mark.parametrize(
    ("content", "columns", "expected"),
    [
        ("t_s,force_n\n0,1.5\n0.001,-2e-3\n", None, {"t_s": [0.0, 0.001], "force_n": [1.5, -0.002]}),
        ("1,2\n3,4\n", ["1"], {"1": [2.0, 4.0]}),
        ("1,a\n5,6\n", ["1"], {"1": [5.0]}),
        ("a,a\n1,2\n", ["1"], {"1": [2.0]}),
        ('t_s,state,force_n\n0,"free, far",0\n1,contact,2\n', ["force_n"], {"force_n": [0.0, 2.0]}),
    ],
)
def test_columns_are_read_by_name_or_else_by_number_from_0(table_of, content, columns, expected):
    assert table_of(content, columns) == expected


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbfa,b\n1,2\n3,4",
        b"a,b\r\n1,2\r\n3,4\r\n",
        b"a,b\r1,2\r3,4\r",
        b"# rig 7\na,b\n1,2\n# pause, long\n3,4\n",
        b"% rig 7\na,b\n1,2\n  % pause, long\n3,4\n",
        b"\n\na,b\n1,2\n   \n3,4\n\n\n",
        b"a, b \n 1 ,2\n3,\t4\n",
        b'"a","b"\n"1","2"\n"3","4"\n',
        "# Kräfte\na,b\n1,2\n3,4\n".encode(),
        "a;b\n1;2\n3;4\n".encode("utf-16"),
        b"a;b\n1;2\n3;4\n",
        b"a\tb\n1\t2\n3\t4\n",
        b"a   b\n1 2\n  3\t4  \n",
        b"a,b,\n1,2,\n3,4,\n",
        b"a,b\n1,2,\n3,4,\n",
        b"# a b\n1 2\n3 4\n",
        b"%a,b\n1,2\n3,4\n",
    ],
)
def test_the_forms_that_programs_write_are_read(table_of, content):
    table = table_of(content, ["a", "b"])
    assert table == {"a": [1.0, 3.0], "b": [2.0, 4.0]}


@pytest.mark.parametrize(
    "cell", ["abc", "-inf", "1e999", "0x10", "1_000", "1;2", "1 2", "--1", "1\x00", "", "nan", "NA"]
)
@pytest.mark.parametrize("clean_rows", [0, 5000])
def test_the_first_bad_cell_is_named_by_line_and_column(table_of, cell, clean_rows):
    content = "# comment\na,b\n" + "1,2\n" * clean_rows + f"\n3,{cell}\n"
    with pytest.raises(FileError, match=rf'file\.csv, line {clean_rows + 4}, column "b": .*no.* finite number'):
        table_of(content)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "the file has no data"),
        ("\n# only a comment\n", "the file has no data"),
        ("a,b\n", "there are no rows under the header"),
        ("a,b\n1,2\n3\n", "line 3: 1 cells; the first line has 2"),
        ("a,b\n1,2,3\n", "line 2: 3 cells; the first line has 2"),
        ("a;b\n" + "1;2\n" * 200 + "3\n", "line 202: 1 cells; the first line has 2"),
        ('a\n1\n"2\n3\n', 'line 3.*"2'),
        ('a,b\n1,1\n2,"2\n3,3\n', "line 3: a quote is opened and not closed"),
        ("a,b\n" + "1,2\n" * 200 + '"1\n3",4\n5,6\n', "line 202: a quote is opened and not closed"),
        ("a;b\n1;" + "x" * 200_000, "line 2: field larger than field limit"),
        ("a\n" + "1" * 2_000_000, "a line is longer than 1048576 characters"),
        (b"a\n1\n\xff\xfe\n", 'line 3, column "a": "ÿþ" is not a finite number'),
        (b"\xff\xfea", "not UTF-16 text"),
        ("a;b\n1,5;2.5\n", 'line 2, column "b": numbers with a decimal point and with a decimal comma'),
    ],
)
def test_a_malformed_file_is_refused_with_the_line(table_of, content, message):
    with pytest.raises(FileError, match=message):
        table_of(content)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("a;b\n1,5;-2\n0,25;1e-3\n", {"a": [1.5, 0.25], "b": [-2.0, 0.001]}),
        ("a\tb\n1,5\t-2\n", {"a": [1.5], "b": [-2.0]}),
        ("0,5 1,5\n0,25 ,5\n", {"0": [0.5, 0.25], "1": [1.5, 0.5]}),
        ("a\n1,5\n2\n", {"a": [1.5, 2.0]}),
        ("a;b\n" + "1;2\n" * 200 + "1;2,5\n", {"a": [1.0] * 201, "b": [2.0] * 200 + [2.5]}),
        ("1,5\n2,25\n", {"0": [1.0, 2.0], "1": [5.0, 25.0]}),
    ],
)
def test_decimal_commas_are_read_where_commas_do_not_separate(table_of, content, expected):
    assert table_of(content) == expected


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    for path, fault in ((tmp_path / "none.csv", r"none\.csv: No such file"), (tmp_path, "is a directory")):
        with pytest.raises(FileError, match=fault):
            read_csv(path)


@pytest.mark.parametrize(
    ("content", "column", "message"),
    [
        ("t_s,force_n\n1,2\n", "fx", 'no column "fx"; there are t_s, force_n'),
        ("t_s,force_n\n1,2\n", "2", r'no column "2".*numbers 0 to 1'),
        ("a,a\n1,2\n", "a", '2 columns are called "a"'),
        ('a\n"free, far"\n', "a", r'file\.csv, line 2, column "a": "free, far" is not a finite number'),
    ],
)
def test_a_column_that_is_not_one_of_numbers_is_refused(table_of, content, column, message):
    with pytest.raises(FileError, match=message):
        table_of(content, [column])


@given(rows=st.lists(st.tuples(finite, finite), min_size=1))
def test_what_is_written_is_read_back_bit_for_bit(tmp_path_factory, rows):
    path = tmp_path_factory.getbasetemp() / "round_trip.csv"
    first, second = [list(column) for column in zip(*rows, strict=True)]
    write_csv(path, {"t_s": first, "force, N": np.array(second)})
    table = read_csv(path)
    assert list(table) == ["t_s", "force, N"]
    for name, written in (("t_s", first), ("force, N", second)):
        assert table[name].tobytes() == np.array(written).tobytes()


@given(
    rows=st.lists(st.tuples(finite, st.one_of(st.none(), finite)), min_size=1, max_size=20),
    separator=st.sampled_from([",", ";", "\t"]),
    decimal=st.sampled_from(".,"),
    header=st.sampled_from(["a{0}b", "# a{0}b", "% remark\na{0}b", '"a"{0}"b"']),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
)
def test_a_table_in_any_form_reads_as_the_numbers_in_it(tmp_path_factory, rows, separator, decimal, header, end):
    if separator == ",":
        decimal = "."
    path = tmp_path_factory.getbasetemp() / "forms.csv"
    cells = [[("" if value is None else repr(value)).replace(".", decimal) for value in row] for row in rows]
    lines = [header.format(separator), *(separator.join(row) for row in cells)]
    path.write_text(end.join(lines).replace("\n", end) + end, newline="")
    expected = [value for value, other in rows if other is not None]
    if len(expected) < len(rows):
        with pytest.raises(FileError, match="no finite number"):
            read_csv(path, ["b"])
    else:
        assert read_csv(path, ["b", "a"])["a"].tolist() == expected


@given(st.text(alphabet="019.,-+e_ #%\"\n\r\tna\x00;'µ"))
def test_any_text_gives_finite_columns_or_a_file_error(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(("a,b\n1,2\n" + text).encode())
    try:
        table = read_csv(path, ["0", "1"])
    except FileError:
        return
    columns = list(table.values())
    assert all(np.isfinite(column).all() and len(column) == len(columns[0]) for column in columns)
    lines = path.read_bytes().decode().replace("\r\n", "\n").replace("\r", "\n").split("\n")
    kept = [line for line in lines if line.lstrip()[:1] not in ("", "#", "%")]
    assert len(columns[0]) == len(kept) - 1, "no line is merged or lost"
