"""Programs that crash, hang, or don't keep to the protocol: the frame fails with a reason, the next one works."""

import os
import signal
import time
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.pipelines.external.programs import INFO, RIG, frame, wicked

from fbench.pipelines.external.messages import ProtocolError
from fbench.pipelines.external.pipeline import Exec, ExecParams, RefusedError
from fbench.pipelines.external.process import ProgramError
from fbench.replay.contracts.errors import ConfigError, DataError, LogError, RunError
from fbench.replay.contracts.protocols import Closes, KeepsStderr, TakesArgument
from fbench.replay.data.rig import Mount, Rig


def x_of(output):
    return output.detections.center_m[:, 0].tolist()


def children() -> list[str]:
    """Processes that this one started and that are still there, zombies too."""
    tasks = Path("/proc/self/task").glob("*/children")
    return sorted(pid for task in tasks for pid in task.read_text().split())


@pytest.fixture(autouse=True)
def nobody_stays():
    before, files = children(), len(os.listdir("/proc/self/fd"))
    yield
    assert children() == before
    assert len(os.listdir("/proc/self/fd")) == files


def test_frames_are_answered_one_by_one(tmp_path):
    with closing(wicked(tmp_path, "")) as pipeline:
        assert isinstance(pipeline, Closes)
        assert isinstance(pipeline, KeepsStderr)
        assert isinstance(Exec, TakesArgument)
        pipeline.start(RIG, INFO)
        assert [x_of(pipeline.step(frame(i))) for i in range(3)] == [[0], [1], [2]]
        pipeline.reset("gap")
        output = pipeline.step(frame(3))
        assert x_of(output) == [103]
        assert output.detections.label.tolist() == ["car"]
        assert output.tracks is None
        assert pipeline.stderr() == b"hello\n"


BROKEN = {
    "crash": ("lambda r: os.kill(os.getpid(), signal.SIGSEGV)", ProgramError, r"exited with 139 \(SIGSEGV\)"),
    "killed": ("lambda r: os.kill(os.getpid(), signal.SIGKILL)", ProgramError, r"exited with 137 \(SIGKILL\)"),
    "exit": ("lambda r: (print('oh no', file=sys.stderr), os._exit(3))", ProgramError,
             r"exited with 3; last line on stderr: oh no"),
    "hang": ("lambda r: time.sleep(60)", ProgramError, r"gave no answer within 0\.5 s"),
    "stopped": ("lambda r: os.kill(os.getpid(), signal.SIGSTOP)", ProgramError, r"gave no answer within 0\.5 s"),
    "half a message": ("lambda r: (write(answer(r, output=output(1))[:20]), time.sleep(60))", ProgramError,
                       r"wrote only 16 of \d+ bytes of an answer within 0\.5 s"),
    "half a message, then exit": ("lambda r: (write(answer(r, output=output(1))[:20]), os._exit(0))", ProgramError,
                                  "exited with 0"),
    "half a length": ("lambda r: (write(b'ab'), time.sleep(60))", ProgramError, "wrote only 2 of 4 bytes"),
    "closed stdout": ("lambda r: (os.close(1), time.sleep(60))", ProgramError, "closed its stdout"),
    "garbage": ("lambda r: frame_of(bytes(range(200, 250)))", ProtocolError, "50 bytes that are no Response"),
    "huge length": ("lambda r: b'\\xff\\xff\\xff\\xff'", ProtocolError, "answer of 4294967295 bytes, at most 67108864"),
    "prints": ("lambda r: b'frame done\\n'", ProtocolError, "'fram': does it print to stdout"),
    "nothing": ("lambda r: frame_of(b'')", ProtocolError, "says nothing"),
    "other request": ("lambda r: frame_of(schema.Response(sequence=99, done=schema.Done()).SerializeToString())",
                      ProtocolError, "answered request 99, expected 5"),
    "wrong kind": ("lambda r: answer(r, done=schema.Done())", ProtocolError, "answered with done, expected output"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_program_that_breaks_is_started_again(tmp_path, case):
    action, error, match = BROKEN[case]
    timeout_s = 0.5 if "sleep" in action or "SIGSTOP" in action else 30.0
    with closing(wicked(tmp_path, f"ACTIONS = {{3: {action}}}", frame_timeout_s=timeout_s)) as pipeline:
        pipeline.start(RIG, INFO)
        assert [x_of(pipeline.step(frame(i))) for i in range(3)] == [[0], [1], [2]]
        with pytest.raises(error, match=match):
            pipeline.step(frame(3))
        # Greeted and reset before it goes on: it counts resets.
        assert x_of(pipeline.step(frame(4))) == [104]
        assert pipeline.stderr().count(b"hello") == 2


KEPT = {
    "says so": ("lambda r: answer(r, error='too dark')", RefusedError, "says: too dark"),
    "no boxes": ("lambda r: answer(r, output=schema.Output())", DataError, "without in_3d or in_2d"),
    "NaN": ("lambda r: answer(r, output=output(float('nan')))", DataError, "detections: geometry of box 0 isn't"),
    "NaN score": ("lambda r: answer(r, output=output(1, score=[float('nan')]))", DataError, "score of box 0 isn't"),
    "lengths": ("lambda r: answer(r, output=output(1, score=[1, 2]))", DataError, r"Boxes3D.score: expected .*\(1\)"),
    "vector": ("lambda r: answer(r, output=output(1, center_m=[1, 2]))", DataError,
               "detections.center_m: expected 3 numbers a box, got 2 in all"),
    "sources": ("lambda r: answer(r, output=output(1, sources=[16]))", DataError, "detections.sources: expected sums"),
    "stages": ("lambda r: answer(r, output=staged(*(dict(name=str(i)) for i in range(65))))", DataError,
               "at most 64, got 65"),
    "time": ("lambda r: answer(r, output=staged(dict(name='x', duration_ns=2**63)))", DataError,
             "'x' took 9223372036854775808 ns"),
}  # fmt: skip


@pytest.mark.parametrize("case", KEPT)
def test_answer_that_is_wrong_fails_the_frame_only(tmp_path, case):
    action, error, match = KEPT[case]
    with closing(wicked(tmp_path, f"ACTIONS = {{1: {action}}}")) as pipeline:
        pipeline.start(RIG, INFO)
        with pytest.raises(error, match=match):
            pipeline.step(frame(1))
        assert x_of(pipeline.step(frame(2))) == [2]
        assert pipeline.stderr().count(b"hello") == 1


def test_second_answer_isnt_taken_for_the_next_frame(tmp_path):
    twice = "ACTIONS = {1: lambda r: 2 * answer(r, output=output(1))}"
    with closing(wicked(tmp_path, twice)) as pipeline:
        pipeline.start(RIG, INFO)
        assert x_of(pipeline.step(frame(1))) == [1]
        with pytest.raises(ProtocolError, match="answered request 2, expected 3"):
            pipeline.step(frame(2))
        assert x_of(pipeline.step(frame(3))) == [103]


def test_program_that_doesnt_read(tmp_path):
    with closing(wicked(tmp_path, "ACTIONS = {0: lambda r: (write(answer(r, output=output(0))), time.sleep(60))}",
                        frame_timeout_s=0.5)) as pipeline:  # fmt: skip
        pipeline.start(RIG, INFO)
        pipeline.step(frame(0))
        with pytest.raises(ProgramError, match=r"read only \d+ of 3600\d\d\d bytes from its stdin within 0\.5 s"):
            pipeline.step(frame(1, num=300_000))
        assert x_of(pipeline.step(frame(2, num=300_000))) == [102]


def test_program_that_is_gone_before_the_frame(tmp_path):
    with closing(wicked(tmp_path, "ACTIONS = {0: lambda r: (write(answer(r, output=output(0))), os._exit(7))}")) as it:
        it.start(RIG, INFO)
        it.step(frame(0))
        time.sleep(0.3)
        with pytest.raises(ProgramError, match="exited with 7"):
            it.step(frame(1, num=300_000))
        assert x_of(it.step(frame(2))) == [102]


def test_flood_on_stdout_is_bounded(tmp_path):
    code = "ACTIONS = {0: lambda r: [write(bytes(1 << 20)) for _ in range(10_000)]}"
    with closing(wicked(tmp_path, code, max_response_mib=1)) as pipeline:
        pipeline.start(RIG, INFO)
        with pytest.raises(ProtocolError, match="says nothing"):  # a length of 0, again and again
            pipeline.step(frame(0))


def test_flood_on_stderr_is_kept_in_part_and_doesnt_block(tmp_path):
    code = "ACTIONS = {0: lambda r: ([sys.stderr.write('x' * 999 + chr(10)) for _ in range(5000)], None)[1]}"
    with closing(wicked(tmp_path, code)) as pipeline:
        pipeline.start(RIG, INFO)
        assert x_of(pipeline.step(frame(0))) == [0]
        assert x_of(pipeline.step(frame(1))) == [1]
        text = pipeline.stderr()
        assert text.startswith(b"hello\nxxx")
        assert b"bytes left out]" in text
        assert len(text) < 1 << 21


def test_reset_and_changed_rig_reach_the_program(tmp_path):
    code = "ACTIONS = {}"
    with closing(wicked(tmp_path, code)) as pipeline:
        pipeline.start(RIG, INFO)
        pipeline.start(Rig({"lidar": replace_pose(RIG.mounts["lidar"])}, {}), INFO)
        pipeline.reset("calibration of lidar changes")
        assert x_of(pipeline.step(frame(0))) == [100]
        assert pipeline.stderr() == b"hello\nhello\n"


def replace_pose(mount: Mount) -> Mount:
    return replace(mount, translation_m=np.ones(3))


def test_reset_after_a_crash_is_done_by_the_restart(tmp_path):
    with closing(wicked(tmp_path, "ACTIONS = {0: lambda r: os._exit(1)}")) as pipeline:
        pipeline.start(RIG, INFO)
        with pytest.raises(ProgramError, match="exited with 1"):
            pipeline.step(frame(0))
        pipeline.reset("gap")
        assert x_of(pipeline.step(frame(1))) == [101]


STARTS = {
    "exits": ("sys.exit('no GPU')", RunError, "can't start: python.* exited with 1; last line on stderr: no GPU"),
    "hangs": ("time.sleep(60)", RunError, r"can't start: python.* gave no answer within 0\.5 s"),
    "other version": ("VERSION = 2", RunError, "speaks version 2 of the protocol, expected 1"),
    "refuses": ("read(4); write(frame_of(schema.Response(sequence=1, error='no camera').SerializeToString()))",
                LogError, "says: no camera"),
}  # fmt: skip


@pytest.mark.parametrize("case", STARTS)
def test_program_that_cannot_start(tmp_path, case):
    code, error, match = STARTS[case]
    pipeline = wicked(tmp_path, code, start_timeout_s=0.5 if case == "hangs" else 20.0)
    with closing(pipeline), pytest.raises(error, match=match):
        pipeline.start(RIG, INFO)


def test_closing_ends_what_ignores_everything(tmp_path):
    code = (
        "signal.signal(signal.SIGTERM, signal.SIG_IGN); import subprocess;"
        "child = subprocess.Popen(['sleep', '60']); print(child.pid, file=sys.stderr, flush=True);"
        "ACTIONS = {0: lambda r: (write(answer(r, output=output(0))), time.sleep(60))}"
    )
    pipeline = wicked(tmp_path, code, close_timeout_s=0.2)
    pipeline.start(RIG, INFO)
    pipeline.step(frame(0))
    begin = time.monotonic()
    pipeline.close()
    pipeline.close()
    assert time.monotonic() - begin < 30  # half of what the program would sleep
    grandchild = int(pipeline.stderr().split()[0])
    for _ in range(100):
        if not Path(f"/proc/{grandchild}").exists() or "Z" in Path(f"/proc/{grandchild}/stat").read_text().split()[2]:
            break
        time.sleep(0.02)
    else:
        pytest.fail("what the program started is still there")


def test_program_may_clean_up_when_its_stdin_closes(tmp_path):
    pipeline = wicked(tmp_path, "import atexit; atexit.register(lambda: print('bye', file=sys.stderr))")
    pipeline.start(RIG, INFO)
    pipeline.close()
    assert pipeline.stderr() == b"hello\nbye\n"


COMMANDS = {
    "": "needs a command",
    "   ": "needs a command",
    "./absent --fast": r"\./absent: no such program$",
    "no-such-program-anywhere": "no such program in PATH or in this folder",
    "./data.txt": r"isn't executable; try chmod \+x",
    ".": "no such program",
    "'unclosed": "can't be split into words",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_that_cannot_run(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data.txt").write_text("x")
    with pytest.raises(ConfigError, match=COMMANDS[command]):
        Exec(ExecParams(command))


def test_program_of_a_wrong_format(tmp_path):
    path = tmp_path / "stack"
    path.write_bytes(b"\x7fELF nonsense")
    path.chmod(0o755)
    pipeline = Exec(ExecParams(str(path)))
    with pytest.raises(ConfigError, match=r"can't be executed \(Exec format error\)"):
        pipeline.start(RIG, INFO)


def test_no_shell_is_involved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pipeline = Exec(ExecParams("cat $(touch pwned) ; touch pwned"))
    with pytest.raises(RunError, match="exited with 1"):
        pipeline.start(RIG, INFO)
    assert not Path("pwned").exists()


def test_parameters_have_limits():
    with pytest.raises(ConfigError, match=r"frame_timeout_s: expected at least 0\.001, got 0"):
        ExecParams(frame_timeout_s=0)
    with pytest.raises(ConfigError, match="max_response_mib: expected between 1 and 1024, got 4096"):
        ExecParams(max_response_mib=4096)


def test_program_has_threads_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("MINE", "yes")
    code = "print(os.environ.get('OMP_NUM_THREADS'), os.environ['MINE'], file=sys.stderr)"
    with closing(wicked(tmp_path, code)) as pipeline:
        pipeline.start(RIG, INFO)
        assert pipeline.stderr() == b"None yes\nhello\n"


def test_interrupt_ends_the_program(tmp_path):
    pipeline = wicked(tmp_path, "ACTIONS = {0: lambda r: time.sleep(60)}", close_timeout_s=0.2)
    pipeline.start(RIG, INFO)

    def interrupt(number, at):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.3)
    try:
        with pytest.raises(KeyboardInterrupt):
            pipeline.step(frame(0))
    finally:
        signal.signal(signal.SIGALRM, before)
        pipeline.close()


DAEMON = """
import subprocess
subprocess.Popen(["sleep", "60"], start_new_session=True, stdin=-3, stdout=-3, stderr=-3)
"""


def test_a_daemon_that_the_program_leaves_behind_is_ended(tmp_path):
    def sleepers() -> int:
        mark = f"FBENCH_EXEC={os.getpid()}-".encode()
        found = 0
        for process in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                is_ours = mark in (process / "environ").read_bytes()
                found += is_ours and (process / "cmdline").read_bytes().startswith(b"sleep")
        return found

    with closing(wicked(tmp_path, DAEMON)) as pipeline:
        pipeline.start(RIG, INFO)
        pipeline.step(frame(0))
        assert sleepers() == 1
    deadline = time.monotonic() + 10
    while sleepers() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert sleepers() == 0
