"""False-alarm probabilities: how often a sound recording or answer has a finding by chance.

Every test of a warning or of a finding whose statistic is known goes by one of these, so that the
number of false warnings over many recordings follows. Smaller ones miss more; larger ones make
warnings that nobody reads.
"""

CHECK = 1e-3  # of a sound estimate or fit, by one check
WIRING = 1e-3  # of a sensor wired as stated, over all faults
BLOCK = 1e-3  # of noise alone, over all blocks of a recording: a block above the noise
PASSES = 1e-3  # of passes that differ by noise alone: a shift, a gain of its own, a scatter
DIRECTIONS = 1e-3  # of a pressure that is the same in both directions of motion
CHANNEL = 1e-3  # of a sound channel, for each finding
OUTLIER = 1e-3  # of a recording in normal noise, over all its samples
DRIFT = 1e-3  # of white noise, for each element
DRIFT_WHERE_NAMED = 0.2  # of white noise, where the user says that there is a drift
MAINS_LINE = 1e-6  # of noise, for each line that is looked for
NOISE_PART = 1e-3  # of white noise, that a correlated part or a trend is found beside it
NOISE_LEVELS = 1e-4  # of elements with the same noise level
