//! The store's tables, and the steps from every older form of them to the newest. A step is never
//! changed once it has shipped; another column needs another step.

/// Marks a SQLite file as one of ours ("vitr").
pub const APPLICATION_ID: i32 = 0x7669_7472;

/// Version of the newest schema.
pub const VERSION: usize = STEPS.len();

/// `STEPS[n]` leads from version n to n + 1; an empty file has version 0.
pub const STEPS: [&str; 4] = [
    // AUTOINCREMENT: numbers of deleted rows do not come back, so that nothing is taken for what it
    // is not.
    "CREATE TABLE trainees (
         id INTEGER PRIMARY KEY AUTOINCREMENT,
         pseudonym TEXT NOT NULL UNIQUE
     ) STRICT;
     CREATE TABLE attempts (
         id INTEGER PRIMARY KEY AUTOINCREMENT,
         trainee INTEGER NOT NULL REFERENCES trainees (id) ON DELETE CASCADE,
         at_s INTEGER NOT NULL,
         module TEXT NOT NULL,
         level INTEGER NOT NULL,
         program TEXT NOT NULL,
         score_version INTEGER NOT NULL,
         seed INTEGER,
         total REAL NOT NULL,
         finished INTEGER NOT NULL,
         took_s REAL NOT NULL,
         recording TEXT,
         recording_sha256 TEXT
     ) STRICT;
     CREATE TABLE points (
         attempt INTEGER NOT NULL REFERENCES attempts (id) ON DELETE CASCADE,
         kind TEXT NOT NULL CHECK (kind IN ('category', 'metric')),
         place INTEGER NOT NULL,
         key TEXT NOT NULL,
         value REAL,
         points REAL NOT NULL,
         of REAL NOT NULL,
         PRIMARY KEY (attempt, kind, place)
     ) STRICT, WITHOUT ROWID;",
    // Uncertainty, scripted surgeons, and one row a recording and version of the score.
    "ALTER TABLE attempts ADD COLUMN sigma REAL NOT NULL DEFAULT 0;
     ALTER TABLE attempts ADD COLUMN surgeon TEXT;
     ALTER TABLE points ADD COLUMN sigma REAL;
     CREATE INDEX attempts_by_trainee ON attempts (trainee, module, at_s);
     DELETE FROM attempts WHERE recording_sha256 IS NOT NULL AND id NOT IN (
         SELECT min(id) FROM attempts GROUP BY trainee, recording_sha256, score_version);
     CREATE UNIQUE INDEX attempts_by_recording ON attempts (trainee, recording_sha256, score_version);",
    // Attempts that were broken off, and what failed the others; before, only ended ones were kept.
    "ALTER TABLE attempts ADD COLUMN broken_off INTEGER NOT NULL DEFAULT 0;
     ALTER TABLE attempts ADD COLUMN failed TEXT;",
    // A checksum of each attempt; those that are there get theirs with this step (`store/seal.rs`).
    "ALTER TABLE attempts ADD COLUMN checksum TEXT;",
];
