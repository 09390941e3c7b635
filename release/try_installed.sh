# What the test of make install-check does in a clean system: sh -eu try_installed.sh demo|no-demo PACKAGE...
# It prints the master's report last.
demo=$1
shift
for tool in cc gcc clang ld; do
    if command -v "$tool"; then echo "$tool is here"; exit 9; fi
done

python3 -m venv installed
. installed/bin/activate
pip install -q --no-index --find-links /wheels "$@"
pip check -q
for package in "$@"; do
    python -c "import $(echo "$package" | tr - _)"
done

hapticnet --version
hapticnet experiment --help >/dev/null
hapticnet gateway --help >/dev/null
hapticnet slave --scene paper:1 --listen 127.0.0.1:47800 --most-sessions 1 --report slave.json -q &
hapticnet master --connect 127.0.0.1:47800 --codec least-squares --insertions 1 --report master.json -q
kill -TERM $!
wait $!
if [ "$demo" = demo ]; then
    hapticnet demo --insertions 1 --out-dir demo -q --json >demo.json
    test -s demo/bytes_per_penetration.png
fi
cat master.json
