# Steps that .ci/run and .ci/nightly share. To be sourced, with the working directory at the root of the checkout.
# A step's log is printed only when the step fails.

root=$PWD
work=$(mktemp -d)
exec 3>&1
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MPLBACKEND=Agg
export PIP_QUIET=1 PIP_DISABLE_PIP_VERSION_CHECK=1
export NO_MKDOCS_2_WARNING=1
newest=$work/newest/bin/python

# run_step NAME COMMAND...: runs a command with its output in a log, prints name, result and seconds, and leaves the
# result in step_status. Not to be called inside `if`, `&&` or `||`: there bash would ignore a failing command in the
# middle of a step.
run_step() {
  local name=$1 begin=$SECONDS
  local log=$work/log_${name//[^a-zA-Z0-9]/_}
  shift
  (set -e; "$@") >"$log" 2>&1 &
  step_status=0
  wait $! || step_status=$?
  if [ "$step_status" -eq 0 ]; then
    printf '%-36s ok %5d s\n' "$name" "$((SECONDS - begin))" >&3
    grep -E '^RERUN|^[0-9]+ passed' "$log" | sed 's/^/    /' >&3 || true
  else
    { printf '%-36s FAILED %d s (status %d)\n' "$name" "$((SECONDS - begin))" "$step_status"; cat "$log"; } >&3
  fi
}

# apt_packages NAME...: installs Debian packages where that is possible; without them some tests are skipped.
apt_packages() {
  if [ $# -eq 0 ] || [ "$(id -u)" -ne 0 ] || ! command -v apt-get; then return 0; fi
  export DEBIAN_FRONTEND=noninteractive
  apt-get update
  apt-get install -y --no-install-recommends "$@"
}

drawing_packages() {
  # Graphviz draws `aerodima models diagram`, which is refused without it; strips and videos need EGL.
  local wanted=()
  command -v dot || wanted+=(graphviz)
  ldconfig -p | grep -q libEGL_mesa || wanted+=(libegl1 libgl1-mesa-dri)
  apt_packages "${wanted[@]}"
}

browser_and_firmware_packages() {
  # Chromium opens replays and console; the cross compiler and QEMU run the firmware on its processor.
  local wanted=()
  command -v chromium || command -v google-chrome || wanted+=(chromium)
  command -v arm-none-eabi-g++ || wanted+=(gcc-arm-none-eabi libnewlib-arm-none-eabi)
  command -v qemu-system-arm || wanted+=(qemu-system-arm)
  apt_packages "${wanted[@]}"
}

newest_python() {
  # The newest Python of the tested range that is installed, by name or under pyenv, or else the default one.
  local candidate
  for candidate in python3.13 ~/.pyenv/versions/3.13.*/bin/python3 python3.12 ~/.pyenv/versions/3.12.*/bin/python3 python3; do
    if "$candidate" -c 'import venv' 2>/dev/null; then
      echo "$candidate"
      return 0
    fi
  done
  echo "no Python with venv was found" >&2
  return 1
}

install_default() {
  # What `make test` needs, and the pages and notebooks; an environment that `make test` made lacks these.
  rm -f .venv/.installed
  make --no-print-directory install INSTALL_GROUPS="--group dev --group docs" INSTALL_EXTRAS='[notebooks]'
}

install_newest() {
  local python
  python=$(newest_python)
  "$python" -m venv "$work/newest"
  "$newest" -m pip install 'pip>=25.1'
  "$newest" -m pip install -e '.[video]' --group dev -c constraints.txt
}

lint() {
  .venv/bin/ruff check .
  .venv/bin/ruff format --check .
}

types() {
  # The stubs of Drake 1.51, the last one for Python 3.11, are wrong for arrays (see pyproject.toml).
  if "$newest" -c 'import sys; sys.exit(sys.version_info >= (3, 12))'; then
    echo "types not checked: no Python 3.12 or newer here" >&3
    return 0
  fi
  "$work/newest/bin/mypy"
}

types_from_outside() {
  # The wheel of an earlier step, in an environment without mypy, and a file of a user.
  if "$newest" -c 'import sys; sys.exit(sys.version_info >= (3, 12))'; then return 0; fi
  cp tests/typed_face.py "$work/away"
  (cd "$work/away" && "$work/newest/bin/mypy" --strict --python-executable "$work/empty/bin/python" typed_face.py)
}

docs() {
  .venv/bin/mkdocs build --quiet --strict  # `make docs` would install again, beneath other steps
}

wheel() {
  # The checkout is out of reach: an empty environment, nothing of ours on the path, and a folder of the user's own
  # whose modules have the names of our packages.
  .venv/bin/python -m build --outdir "$work/dist" .  # the source archive, and the wheel from it
  .venv/bin/python -m venv "$work/empty"
  "$work/empty/bin/pip" install "$(echo "$work"/dist/*.whl)[console,hardware]" -c constraints.txt
  mkdir -p "$work/away/optimisation"
  local name
  for name in hardware.py workbench.py optimisation/__init__.py; do
    echo 'raise RuntimeError("the module of the user was imported")' >"$work/away/$name"
  done
  (
    cd "$work/away"
    export PATH="$work/empty/bin:$PATH" PYTHONPATH=$work/away
    python -c "
from aerodima import hardware, optimisation, workbench
from aerodima.workbench.core.resources import models_dir
for path in (hardware.__file__, optimisation.__file__, workbench.__file__, str(models_dir())):
    assert not path.startswith('$root/'), path
"
    aerodima --help
    aerodima models check
    aerodima run turn_swing --speed 3.33 --out turn.parquet
    aerodima log metrics turn.parquet
    aerodima replay turn.parquet --html turn.html
    # A tail on other robots, from the page alone.
    cp "$root/tests/page_blocks.py" "$root/docs/extend/any_robot.md" .
    python -P page_blocks.py any_robot.md
    # The page's address is printed when the emulated car, a process of its own, is ready.
    timeout 120 aerodima console auto_turn --no-view --port 0 --out car >console.log 2>&1 &
    for _ in $(seq 60); do grep -q http:// console.log && break; sleep 1; done
    kill -TERM $! || true
    wait $! || true
    cat console.log
    grep -q http:// console.log
  )
}

fast_tests_newest() {
  "$newest" -m pytest -q -n 2 --dist loadfile -m "not slow and not realtime and not emulated and not nightly" \
    -p no:cacheprovider
}

# Each notebook must give what is stored of it. One at a time: of two kernels that start together one may hang.
notebooks() {
  local notebook status=0
  for notebook in notebooks/[0-9]*.ipynb; do
    local begin=$SECONDS
    .venv/bin/python -m tests.notebook_runs --check "$notebook" </dev/null || status=1
    echo "$notebook: $((SECONDS - begin)) s"
  done
  return "$status"
}

clean_up() {
  local running
  running=$(jobs -p)
  if [ -n "$running" ]; then kill $running 2>/dev/null || true; fi
  rm -rf "$work"
}
