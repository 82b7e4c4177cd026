# Sourced by demo.sh and tests/run.sh: Debian/Ubuntu packages and the Python to use.

LIBRARIES="libusb-1.0-0 libgl1 libegl1 libx11-6 libidn2-0 libgomp1" # what Open3D's wheel links against
VIEWER_LIBRARIES="mesa-vulkan-drivers libvulkan1"                   # a software Vulkan for the headless viewer

# Installs the packages that are missing, or says which ones would be needed where it may not.
install_system_packages() {
    command -v dpkg-query >/dev/null || return 0
    local missing="" package
    for package in $1; do
        dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q "ok installed" || missing="$missing $package"
    done
    [ -n "$missing" ] || return 0
    if [ "$(id -u)" -ne 0 ]; then
        echo "not root, so not installed; if something fails to load: sudo apt-get install$missing" >&2
        return 0
    fi
    echo "installing$missing"
    apt-get update -qq
    # shellcheck disable=SC2086
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing >/dev/null
}

# Prints a Python of at least 3.11 that can make virtual environments; the distribution's on a fresh machine.
find_python() {
    local python
    for python in python3 python3.13 python3.12 python3.11; do
        if "$python" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            command -v "$python"
            return 0
        fi
    done
    echo "Python 3.11 or newer with the venv module is needed (Debian, Ubuntu: apt-get install python3 python3-venv)" >&2
    return 1
}
