"""One model of the image of a body: how probable a pose and the owners of its detections are, against clutter alone.

`rootmatch.model.detection_model.DetectionModel` says what is known of the body and the image,
`rootmatch.model.evidence.evidence` weighs hypotheses (an assignment with its pose each),
`rootmatch.model.posterior.posterior` turns those of one body into probabilities, and
`rootmatch.model.competition.joint_posterior` those of several bodies that compete for detections. Poses and assignments
are arrays: nothing here knows where they come from. Formulas and measured errors: docs/model.md.
"""
