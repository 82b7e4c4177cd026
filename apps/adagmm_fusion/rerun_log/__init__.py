"""Registrations for the Rerun viewer: did it work, how well, and if not, why.

Each function logs one thing to the RecordingStream it is given; the blueprint is a value. In short:

    with open_stream(args, name, dashboard(many_pairs=True)) as rec:
        em_step = 0
        for i, pair in enumerate(recording):
            ...
            em_step = log_pair(rec, pair, source_cloud, target_cloud, estimate, frame_index=i, em_step=em_step)
        log_recording_summary(rec, records)

and for a script, which gets before, after, every iteration and the curves:

    registration_adaptive_gmm(source, target, 0.05, callback_after_iteration=RegistrationLogger(rec, source, target))
"""

from adagmm_fusion.rerun_arguments import add_rerun_arguments
from adagmm_fusion.rerun_log.blueprint import dashboard, script_dashboard
from adagmm_fusion.rerun_log.fused_recording import FusedRecording, fused_blueprint, log_fused_recording
from adagmm_fusion.rerun_log.iterations import log_estimate_iterations
from adagmm_fusion.rerun_log.pair import log_pair, log_refused_pair
from adagmm_fusion.rerun_log.properties import log_recording_properties, log_result
from adagmm_fusion.rerun_log.registration_logger import RegistrationLogger
from adagmm_fusion.rerun_log.streams import check_destination, open_stream
from adagmm_fusion.rerun_log.summary import Progress, log_recording_summary
from adagmm_fusion.rerun_log.verdict import Limits
from adagmm_fusion.rerun_log.verified_rig import log_verified_rig, verified_rig_blueprint
from adagmm_fusion.rerun_log.views import Eye
from adagmm_fusion.rerun_log.when import When

__all__ = [
    "Eye",
    "FusedRecording",
    "Limits",
    "Progress",
    "RegistrationLogger",
    "When",
    "add_rerun_arguments",
    "check_destination",
    "dashboard",
    "fused_blueprint",
    "log_estimate_iterations",
    "log_fused_recording",
    "log_pair",
    "log_recording_properties",
    "log_recording_summary",
    "log_refused_pair",
    "log_result",
    "log_verified_rig",
    "open_stream",
    "script_dashboard",
    "verified_rig_blueprint",
]
