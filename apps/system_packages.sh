# Sourced by demo.sh and the scripts of tests/: Debian/Ubuntu packages, the Python to use, and the project's installation.

LIBRARIES="libusb-1.0-0 libgl1 libegl1 libx11-6 libidn2-0 libgomp1" # what Open3D's wheel links against
VIEWER_LIBRARIES="mesa-vulkan-drivers libvulkan1"                   # a software Vulkan for the headless viewer

# Installs the packages that are missing. Where it may not, says which, once more as the last line when the script fails;
# and as nothing works without those that are in LIBRARIES, stops before anything is downloaded.
install_system_packages() {
    command -v dpkg-query >/dev/null || return 0
    local missing="" vital="" package
    for package in $1; do
        dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q "ok installed" && continue
        missing="$missing $package"
        case " $LIBRARIES " in *" $package "*) vital="$vital $package" ;; esac
    done
    [ -n "$missing" ] || return 0
    apt_line="apt-get install$missing"
    trap 'if [ $? -ne 0 ]; then echo "system libraries are missing: sudo $apt_line" >&2; fi' EXIT
    if [ "$(id -u)" -ne 0 ]; then
        [ -n "$vital" ] || { echo "not root, so not installed:$missing; what needs them will be skipped" >&2; return 0; }
        echo "not root, so not installed:$vital; if they come from elsewhere, set ADAGMM_SYSTEM_LIBRARIES=mine" >&2
        [ "${ADAGMM_SYSTEM_LIBRARIES:-}" = mine ] || exit 1
        return 0
    fi
    echo "installing$missing"
    apt-get update -qq
    # shellcheck disable=SC2086
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing >/dev/null
    trap - EXIT
}

# Prints a Python of 3.11 to 3.14 that can make virtual environments; the distribution's on a fresh machine.
find_python() {
    local python
    for python in python3 python3.13 python3.12 python3.11 python3.14; do
        if "$python" -c 'import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2>/dev/null; then
            command -v "$python"
            return 0
        fi
    done
    echo "Python 3.11 to 3.14 with the venv module is needed (Debian, Ubuntu: apt-get install python3 python3-venv)" >&2
    return 1
}

# Installs the project with the extras $1 and Open3D into .venv, if they are not there as pyproject.toml has them now; so
# that a second time needs no network. An Open3D that is there already stays; else ADAGMM_OPEN3D=open3d-cpu takes the
# smaller package of the two.
install_project() {
    local open3d=${ADAGMM_OPEN3D:-open3d} stamp=".venv/installed-$1" wanted
    if [ ! -x .venv/bin/python ]; then
        local python
        python="$(find_python)"
        echo "making .venv with $python"
        "$python" -m venv .venv
    fi
    ! .venv/bin/python -m pip show --quiet open3d-cpu 2>/dev/null || open3d=open3d-cpu
    wanted="$PWD $open3d $(cat pyproject.toml adagmm_o3d/version.py | cksum)"
    [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ] || return 0
    echo "installing the project with [$1,$open3d] into .venv"
    .venv/bin/python -m pip install --quiet --disable-pip-version-check -e ".[$1,$open3d]"
    echo "$wanted" >"$stamp"
}
