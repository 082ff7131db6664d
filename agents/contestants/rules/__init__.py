"""Classical rules that set the knobs from the pending innovation (SPEC 6, 10).

They see what every agent sees: the innovation nu, its variance S under the nominal
knobs, and the noise R that the filter was told; H P H^T is S - R. Channels that did
not arrive are NaN and leave a rule's memory as it was; the ``info`` of ``env.step`` has zero
and infinity there, so that who calls a rule from it must put NaN back.
"""
