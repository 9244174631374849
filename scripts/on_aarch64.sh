#!/bin/sh
# Run the offline tests on aarch64, which qemu-user emulates on this x86-64 machine, and compare its answers with ours.
#
# scripts/on_aarch64.sh FOLDER [PYTEST'S ARGUMENTS...]
#
# FOLDER gets Python of Debian 12 and the libraries for aarch64 (350 MB); nothing is installed outside it. The emulator
# is Debian's package qemu-user. Each process that a test starts by `sys.executable` is emulated, too. The model is
# compiled here for aarch64. SCENES is the number of random scenes (200) whose answers are compared. One test is left
# out: it loads a library before all others, of which the programs of this machine complain.
set -eu

TESTS="tests/model tests/streams tests/bags tests/offline"
PACKAGES="python3.11 python3.11-minimal libpython3.11-stdlib libpython3.11-minimal libc6 libexpat1 zlib1g libgcc-s1
    libstdc++6 libffi8 libssl3 libbz2-1.0 liblzma5 libcrypt1 libuuid1 libsqlite3-0 libgomp1"
[ $# -gt 0 ] || { echo "usage: $0 FOLDER [PYTEST'S ARGUMENTS...]" >&2; exit 2; }
command -v qemu-aarch64 >/dev/null || { echo "$0: there is no qemu-aarch64; on Debian: apt install qemu-user" >&2; exit 2; }
here=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$1"
work=$(cd "$1" && pwd)
shift
python=$here/.venv/bin/python
checkout=$work/knee_contact_ros

if [ ! -x "$work/root/usr/bin/python3.11" ]; then
    mkdir -p "$work/apt/lists/partial" "$work/apt/archives/partial" "$work/debs" "$work/root"
    touch "$work/apt/status"
    echo "deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] http://deb.debian.org/debian bookworm main" \
        >"$work/apt/sources"
    cat >"$work/apt/conf" <<EOF
Dir::State "$work/apt";
Dir::State::status "$work/apt/status";
Dir::Cache "$work/apt";
Dir::Etc::sourcelist "$work/apt/sources";
Dir::Etc::sourceparts "-";
APT::Architecture "arm64";
APT::Architectures "arm64";
EOF
    export APT_CONFIG="$work/apt/conf"
    apt-get --quiet=2 update
    # shellcheck disable=SC2086  # they are words
    (cd "$work/debs" && apt-get --quiet=2 download $PACKAGES)
    for package in "$work"/debs/*.deb; do dpkg-deb --extract "$package" "$work/root"; done
fi

"$here/.venv/bin/uv" pip install --quiet --target "$work/site" --python-version 3.11 \
    --python-platform aarch64-manylinux_2_28 --only-binary :all: --requirements "$here/pyproject.toml" \
    "pytest>=8,<9.2" hypothesis jinja2 matplotlib numba pandas psutil tabulate
"$here/.venv/bin/uv" pip install --quiet --target "$work/tools" "ziglang>=0.13"

rm -rf "$checkout"
mkdir "$checkout"
(cd "$here" && git ls-files -z --cached --others --exclude-standard | xargs -0 cp --parents --target-directory "$checkout")
mkdir -p "$checkout/.venv/bin"
cat >"$checkout/.venv/bin/python" <<EOF
#!/bin/sh
export CC="$checkout/.venv/bin/cc" PATH="$checkout/.venv/bin:\$PATH"
export PYTHONHOME="$work/root/usr" PYTHONPATH="\${PYTHONPATH:+\$PYTHONPATH:}$checkout:$work/site"
exec qemu-aarch64 -L "$work/root" -0 "$checkout/.venv/bin/python" "$work/root/usr/bin/python3.11" "\$@"
EOF
cat >"$checkout/.venv/bin/cc" <<EOF
#!/bin/sh
exec env --unset PYTHONHOME PYTHONPATH="$work/tools" "$python" -m ziglang cc -target aarch64-linux-gnu.2.36 "\$@"
EOF
chmod +x "$checkout/.venv/bin/python" "$checkout/.venv/bin/cc"
ln -sfn "$checkout" "$work/root/usr/share/knee_contact_ros"  # where a copy of the package finds its parameter files
(cd "$checkout" && PYTHONPATH="$checkout:$work/tools" "$python" - <<'EOF'
from pathlib import Path

from knee_contact_ros.model import kernel
from knee_contact_ros.model.compiler import TARGETS, build

file = Path(kernel.__file__).with_name(kernel._file_name())
build(kernel.portable_code(), TARGETS["aarch64"], file)
print(f"== {file.name}, compiled for aarch64")
EOF
)

echo "== Tests on $("$checkout/.venv/bin/python" -c 'import platform; print(platform.machine(), platform.python_version())')"
cd "$checkout"
# shellcheck disable=SC2086
status=0
.venv/bin/python -m pytest -q -p no:cacheprovider --continue-on-collection-errors $TESTS "$@" \
    --deselect tests/bags/test_recover.py::test_a_full_disk_leaves_nothing_behind || status=$?
echo "== Answers of aarch64 and of this machine"
cd "$here"
"$python" -m scripts.same_messages "$checkout" --scenes "${SCENES:-200}"
exit $status
