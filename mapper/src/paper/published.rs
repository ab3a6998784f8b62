//! Figures as `[plmap2025]` prints them, number by number: median position in centimetres, median rotation in degrees, share of
//! the test pictures within 5 cm and 5 degrees in percent. Its 7-Scenes figures are on the poses as shipped (KinectFusion). Rows of
//! other methods are the ones that the paper shows beside its own.

/// Median position (cm), median rotation (degrees), recall at 5 cm and 5 degrees (percent).
pub(super) type Printed = [f64; 3];

/// What is printed of a scene.
#[derive(Debug)]
pub(super) struct Scene {
    /// Its folder in the data set.
    pub(super) folder: &'static str,
    /// As the paper calls it.
    pub(super) title: &'static str,
    /// Test pictures of the official split.
    pub(super) num_test: usize,
    /// In the order of the set's methods.
    pub(super) rows: &'static [Printed],
    /// Forward pass and pose in milliseconds, frames a second: PL2Map, the paper with DeepLSD, the paper with LSD. Empty where the
    /// paper prints none.
    pub(super) timing: &'static [Printed],
}

/// Methods of the table of 7-Scenes.
pub(super) const SEVEN_SCENES_METHODS: &[&str] =
    &["Hloc", "PtLine", "Limap", "PL2Map", "the paper"];

/// Methods of the table of Indoor-6. PoseNet and a second variant of NBE+SLD are left out: both are weaker throughout.
pub(super) const INDOOR6_METHODS: &[&str] = &[
    "Hloc",
    "Limap",
    "DSAC*",
    "ACE",
    "NBE+SLD",
    "D2S",
    "PL2Map",
    "the paper",
];

/// Columns of the paper's table of times.
pub(super) const TIMED: &[&str] = &["PL2Map, DeepLSD", "the paper, DeepLSD", "the paper, LSD"];

pub(super) const SEVEN_SCENES: &[Scene] = &[
    Scene {
        folder: "chess",
        title: "Chess",
        num_test: 2000,
        rows: &[
            [2.4, 0.84, 93.0],
            [2.4, 0.85, 92.7],
            [2.5, 0.85, 92.3],
            [1.9, 0.63, 96.0],
            [2.0, 0.62, 96.1],
        ],
        timing: &[],
    },
    Scene {
        folder: "fire",
        title: "Fire",
        num_test: 2000,
        rows: &[
            [2.3, 0.89, 88.9],
            [2.3, 0.91, 87.9],
            [2.1, 0.84, 95.5],
            [1.9, 0.80, 94.0],
            [1.9, 0.77, 91.8],
        ],
        timing: &[],
    },
    Scene {
        folder: "heads",
        title: "Heads",
        num_test: 1000,
        rows: &[
            [1.1, 0.75, 95.9],
            [1.2, 0.81, 95.2],
            [1.1, 0.76, 95.9],
            [1.1, 0.71, 98.2],
            [1.1, 0.70, 98.8],
        ],
        timing: &[],
    },
    Scene {
        folder: "office",
        title: "Office",
        num_test: 4000,
        rows: &[
            [3.1, 0.91, 77.0],
            [3.2, 0.96, 74.5],
            [3.0, 0.89, 78.4],
            [2.7, 0.74, 84.3],
            [2.5, 0.69, 87.2],
        ],
        timing: &[],
    },
    Scene {
        folder: "pumpkin",
        title: "Pumpkin",
        num_test: 2000,
        rows: &[
            [5.0, 1.32, 50.4],
            [5.1, 1.35, 49.0],
            [4.7, 1.23, 52.9],
            [3.4, 0.93, 64.1],
            [2.9, 0.86, 68.3],
        ],
        timing: &[],
    },
    Scene {
        folder: "redkitchen",
        title: "RedKitchen",
        num_test: 5000,
        rows: &[
            [4.2, 1.39, 58.9],
            [4.3, 1.42, 58.0],
            [4.1, 1.39, 60.2],
            [3.7, 1.10, 68.9],
            [3.7, 1.12, 71.0],
        ],
        timing: &[],
    },
    Scene {
        folder: "stairs",
        title: "Stairs",
        num_test: 1000,
        rows: &[
            [5.2, 1.46, 46.8],
            [4.8, 1.33, 51.9],
            [3.7, 1.02, 71.1],
            [7.6, 2.0, 33.3],
            [7.2, 1.92, 34.0],
        ],
        timing: &[],
    },
];

pub(super) const INDOOR6: &[Scene] = &[
    Scene {
        folder: "scene1",
        title: "Scene-1",
        num_test: 799,
        rows: &[
            [1.2, 0.22, 88.2],
            [1.1, 0.21, 90.7],
            [12.3, 2.06, 18.7],
            [13.6, 2.1, 24.9],
            [6.5, 0.90, 38.4],
            [4.8, 0.81, 51.8],
            [4.7, 0.84, 51.7],
            [3.6, 0.59, 64.0],
        ],
        timing: &[[94.9, 23.8, 8.4], [93.6, 25.6, 8.3], [30.5, 30.6, 16.4]],
    },
    Scene {
        folder: "scene2a",
        title: "Scene-2a",
        num_test: 257,
        rows: &[
            [1.1, 0.12, 94.2],
            [1.0, 0.12, 95.3],
            [7.9, 0.9, 28.0],
            [6.8, 0.7, 31.9],
            [7.2, 0.68, 32.7],
            [4.0, 0.41, 61.1],
            [4.8, 0.49, 53.7],
            [3.1, 0.32, 75.5],
        ],
        timing: &[[99.5, 11.2, 9.0], [98.8, 17.0, 8.6], [31.1, 17.0, 20.8]],
    },
    Scene {
        folder: "scene3",
        title: "Scene-3",
        num_test: 315,
        rows: &[
            [0.7, 0.15, 95.2],
            [0.6, 0.15, 96.2],
            [13.1, 2.34, 19.7],
            [8.1, 1.3, 33.0],
            [4.4, 0.91, 53.0],
            [3.6, 0.69, 60.0],
            [5.3, 1.05, 49.2],
            [3.1, 0.62, 65.8],
        ],
        timing: &[[99.3, 44.4, 7.0], [97.1, 56.0, 6.5], [34.2, 67.3, 9.8]],
    },
    Scene {
        folder: "scene4a",
        title: "Scene-4a",
        num_test: 158,
        rows: &[
            [1.0, 0.24, 94.3],
            [1.0, 0.25, 95.6],
            [3.7, 0.95, 60.8],
            [4.8, 0.9, 55.7],
            [3.8, 0.94, 66.5],
            [2.1, 0.48, 84.8],
            [2.0, 0.49, 82.9],
            [1.6, 0.38, 85.4],
        ],
        timing: &[[95.6, 7.5, 9.7], [93.2, 17.3, 9.0], [33.7, 19.4, 18.8]],
    },
    Scene {
        folder: "scene5",
        title: "Scene-5",
        num_test: 424,
        rows: &[
            [2.0, 0.33, 81.4],
            [1.8, 0.31, 81.4],
            [40.7, 6.72, 10.6],
            [14.7, 2.3, 17.9],
            [6.0, 0.91, 40.0],
            [5.8, 0.90, 45.5],
            [7.7, 1.21, 40.3],
            [6.0, 0.87, 42.9],
        ],
        timing: &[[95.8, 15.0, 9.0], [94.3, 37.3, 7.3], [30.0, 41.0, 14.1]],
    },
    Scene {
        folder: "scene6",
        title: "Scene-6",
        num_test: 323,
        rows: &[
            [0.6, 0.13, 97.2],
            [0.5, 0.13, 96.9],
            [6.0, 1.40, 44.3],
            [6.1, 1.1, 45.5],
            [5.0, 0.99, 50.5],
            [2.4, 0.48, 75.2],
            [3.41, 0.61, 64.1],
            [2.3, 0.40, 74.9],
        ],
        timing: &[[96.2, 10.2, 9.4], [94.6, 18.8, 8.8], [31.1, 20.0, 19.6]],
    },
];
