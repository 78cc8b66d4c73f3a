# What the scripts share; they source this file. It leaves the shell in the project's root, with the project's own
# settings for cargo and the helpers below.

cd "$(dirname "${BASH_SOURCE[0]}")/.."

# A shell that is not a login shell often lacks rustup's folder.
PATH="$PATH:${CARGO_HOME:-${HOME:-/root}/.cargo}/bin"

bold='' plain='' color=never
if [[ -t 1 && -z "${NO_COLOR:-}" ]]; then
    bold=$'\e[1m' plain=$'\e[0m' color=auto
fi

heading() { printf '\n%s== %s%s\n' "$bold" "$*" "$plain"; }
say() { printf '%s\n' "$*" >&2; }
have() { command -v "$1" >/dev/null 2>&1; }

# missing SENTENCE...: says what goes unchecked; in CI nothing may.
missing() {
    say "$@"
    [[ "${CI:-}" != true ]] || exit 1
}

# apt_install PACKAGE...: installs Debian packages as root or through sudo without a password; fails quietly where
# that is not possible. The lists are fetched only when an installation fails without: a fresh container has none.
apt_install() {
    have apt-get || return 1
    local apt=(env DEBIAN_FRONTEND=noninteractive apt-get -qq -o Dpkg::Use-Pty=0)
    if ((EUID != 0)); then
        have sudo && sudo -n true 2>/dev/null || return 1
        apt=(sudo -n "${apt[@]}")
    fi
    heading "Installing $*"
    "${apt[@]}" install --no-install-recommends -y "$@" >/dev/null 2>&1 && return
    "${apt[@]}" update && "${apt[@]}" install --no-install-recommends -y "$@" >/dev/null
}

# The first python3 that has what the Python package needs: apt's modules are seen by apt's own only.
python_with_modules() {
    local python
    for python in python3 /usr/bin/python3; do
        if "$python" -c 'import numpy, cffi, setuptools, pip, wheel' >/dev/null 2>&1; then
            printf '%s' "$python"
            return
        fi
    done
    return 1
}

# python_of NAME: a Python with the packages of tests/NAME.txt, in an environment of their own, made anew where that list has
# changed. COPHASE_PYTHON makes it.
python_of() {
    local folder list=tests/$1.txt
    folder=$(realpath -m "${CARGO_TARGET_DIR:-target}")/python/$1
    [[ -n "${COPHASE_PYTHON:-}" ]] || return 1
    if ! cmp -s "$list" "$folder/made-of.txt"; then
        heading "Installing $1" >&2
        "$COPHASE_PYTHON" -m venv --without-pip --clear "$folder" >&2 &&
            "$COPHASE_PYTHON" -m pip --python "$folder/bin/python" install --quiet -r "$list" >&2 &&
            cp "$list" "$folder/made-of.txt" || return 1
    fi
    printf '%s' "$folder/bin/python"
}

# Rust, a C compiler and make: without them nothing is built. All that can be missing is said at once.
require_build_tools() {
    local missing=0
    if ! have cargo; then
        say "cargo is missing: install Rust 1.88 or newer from https://rustup.rs."
        missing=1
    fi
    have make || apt_install make || true
    if ! have make; then
        say "make is missing, which builds the bundled cfitsio: install it with 'apt-get install make' as root."
        missing=1
    fi
    # Not installed for the user: which compiler a machine has is its owner's choice.
    if ! have cc; then
        say "cc, the C compiler and linker, is missing: install it with 'apt-get install gcc libc6-dev' as root."
        missing=1
    fi
    ((missing == 0)) || exit 1
}
