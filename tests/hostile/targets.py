"""All kinds of untrusted input that are fuzzed, by name."""

from collections.abc import Mapping
from functools import partial

from tests.hostile import mcap_logs
from tests.hostile.target import Target


def _mcap(kind):
    return partial(mcap_logs.damaged, kind), _log


def _log(folder, is_forged=False):
    return mcap_logs.read(folder / mcap_logs.NAME, is_forged)


TARGETS: Mapping[str, Target] = {
    "mcap": Target("MCAP in chunks, damaged", *_mcap("mcap")),
    "mcap-no-summary": Target("MCAP in chunks without a summary, damaged", *_mcap("mcap-no-summary")),
    "mcap-unchunked": Target("MCAP without chunks, damaged", *_mcap("mcap-unchunked")),
    "mcap-no-checksums": Target("MCAP without checksums, damaged", *_mcap("mcap-no-checksums")),
    "mcap-forged": Target("MCAP, fields edited under right checksums", mcap_logs.forged, partial(_log, is_forged=True)),
}
