//! Attempts as a table: one row each, the same columns for every batch that is given the same keys,
//! so that the tables of many machines can be put together.

use crate::attempt::{Attempt, Points, Stored};
use crate::batch::Row;
use outputs::no_formula;
use std::collections::HashMap;
use std::io::{self, Write};

/// Column of the recordings' hashes.
const HASH: &str = "recording_sha256";

/// The cells of a column; a cell may be empty.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)]
pub enum Cells {
    Text(Vec<Option<String>>),
    Whole(Vec<Option<i64>>),
    Natural(Vec<Option<u64>>),
    Real(Vec<Option<f64>>),
    Truth(Vec<Option<bool>>),
}

impl Cells {
    /// What they hold, in a word.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Cells::Text(_) => "text",
            Cells::Whole(_) => "whole",
            Cells::Natural(_) => "natural",
            Cells::Real(_) => "real",
            Cells::Truth(_) => "truth",
        }
    }

    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        match self {
            Cells::Text(c) => c.len(),
            Cells::Whole(c) => c.len(),
            Cells::Natural(c) => c.len(),
            Cells::Real(c) => c.len(),
            Cells::Truth(c) => c.len(),
        }
    }

    /// None of the same kind.
    fn of_same_kind(&self) -> Cells {
        match self {
            Cells::Text(_) => Cells::Text(Vec::new()),
            Cells::Whole(_) => Cells::Whole(Vec::new()),
            Cells::Natural(_) => Cells::Natural(Vec::new()),
            Cells::Real(_) => Cells::Real(Vec::new()),
            Cells::Truth(_) => Cells::Truth(Vec::new()),
        }
    }

    /// Adds a cell of another column; false where that is of another kind.
    fn push_of(&mut self, other: &Cells, row: usize) -> bool {
        match (self, other) {
            (Cells::Text(to), Cells::Text(from)) => to.push(from[row].clone()),
            (Cells::Whole(to), Cells::Whole(from)) => to.push(from[row]),
            (Cells::Natural(to), Cells::Natural(from)) => to.push(from[row]),
            (Cells::Real(to), Cells::Real(from)) => to.push(from[row]),
            (Cells::Truth(to), Cells::Truth(from)) => to.push(from[row]),
            _ => return false,
        }
        true
    }

    /// A cell for people and CSV. Real numbers have as many digits as lead back to the same bits.
    fn to_csv(&self, row: usize) -> String {
        fn text<T: ToString>(cell: &Option<T>) -> String {
            cell.as_ref().map_or_else(String::new, T::to_string)
        }
        match self {
            Cells::Text(c) => c[row].as_deref().map_or_else(String::new, |t| no_formula(t).into_owned()),
            Cells::Whole(c) => text(&c[row]),
            Cells::Natural(c) => text(&c[row]),
            Cells::Real(c) => text(&c[row]),
            Cells::Truth(c) => text(&c[row]),
        }
    }
}

/// A column.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Its name: small letters, digits, `_`.
    pub name: String,
    /// Its cells, as many as those of every other column.
    pub cells: Cells,
}

/// Columns of one length.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Table {
    /// The columns.
    pub columns: Vec<Column>,
    /// The rows that each has.
    pub rows: usize,
}

/// Categories and metrics that get columns, in this order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Keys {
    /// Categories.
    pub categories: Vec<String>,
    /// Metrics.
    pub metrics: Vec<String>,
}

impl Keys {
    /// Adds what an attempt has and the keys lack (an older version of the score had other
    /// metrics).
    pub fn widen(&mut self, attempt: &Attempt) {
        for (keys, points) in
            [(&mut self.categories, &attempt.categories), (&mut self.metrics, &attempt.metrics)]
        {
            for p in points {
                if !keys.contains(&p.key) {
                    keys.push(p.key.clone());
                }
            }
        }
    }
}

impl Table {
    fn put(&mut self, name: &str, cells: Cells) {
        debug_assert_eq!(cells.len(), self.rows);
        self.columns.push(Column { name: name.replace('-', "_"), cells });
    }

    /// Attempts of the store.
    pub fn of_store(all: &[Stored], mut keys: Keys) -> Self {
        all.iter().for_each(|s| keys.widen(&s.attempt));
        let mut table = Table { rows: all.len(), ..Table::default() };
        table.put("id", Cells::Whole(all.iter().map(|s| Some(s.id)).collect()));
        table.put("trainee", Cells::Text(all.iter().map(|s| Some(s.trainee.clone())).collect()));
        table.put("at", Cells::Text(all.iter().map(|s| Some(s.at.clone())).collect()));
        table.put("broken_off", Cells::Truth(all.iter().map(|s| Some(s.attempt.broken_off)).collect()));
        let attempts: Vec<_> = all.iter().map(|s| Some(&s.attempt)).collect();
        table.attempts(&attempts, &keys);
        table
    }

    /// The rows of a batch; attempts have no cells where a recording could not be scored.
    pub fn of_batch(rows: &[Row], keys: &Keys) -> Self {
        let mut table = Table { rows: rows.len(), ..Table::default() };
        let attempts: Vec<_> = rows.iter().map(|r| r.attempt.as_ref()).collect();
        let hashes = rows.iter().map(|r| r.sha256.clone()).collect();
        table.put("file", Cells::Text(rows.iter().map(|r| Some(r.file.display().to_string())).collect()));
        table.put("problem", Cells::Text(rows.iter().map(|r| r.problem.clone()).collect()));
        table.put("seconds", Cells::Real(rows.iter().map(|r| Some(r.seconds)).collect()));
        let ended = rows.iter().map(|r| r.attempt.as_ref().map(|_| r.ended));
        table.put("ended", Cells::Truth(ended.collect()));
        table.put("agrees", Cells::Truth(rows.iter().map(|r| r.agrees).collect()));
        table.attempts(&attempts, keys);
        table.set(HASH, Cells::Text(hashes));
        table.name_same();
        table
    }

    /// A column by its name.
    pub fn column(&self, name: &str) -> Option<&Cells> {
        self.columns.iter().find(|c| c.name == name).map(|c| &c.cells)
    }

    /// The texts of a column; nothing where there is no such column of texts.
    pub fn texts(&self, name: &str) -> &[Option<String>] {
        if let Some(Cells::Text(cells)) = self.column(name) { cells } else { &[] }
    }

    fn set(&mut self, name: &str, cells: Cells) {
        match self.columns.iter_mut().find(|c| c.name == name) {
            Some(column) => column.cells = cells,
            None => self.put(name, cells),
        }
    }

    /// Fills the column `same_as`: the first recording of the table with the same content, of those
    /// that have one before them.
    pub fn name_same(&mut self) {
        let mut first: HashMap<&str, &str> = HashMap::new();
        let same = self.texts("file").iter().zip(self.texts(HASH)).map(|(file, hash)| {
            let (file, hash) = (file.as_deref()?, hash.as_deref()?);
            let first = *first.entry(hash).or_insert(file);
            (first != file).then(|| first.to_owned())
        });
        let same = same.collect();
        self.set("same_as", Cells::Text(same));
    }

    /// One table of the rows of several: the first of each, then the second of each, and so on, as
    /// the shards of a list share it. `None` where their columns differ.
    pub fn interleaved(parts: &[&Table]) -> Option<Table> {
        let first = parts.first()?;
        let mut whole = Table { rows: parts.iter().map(|t| t.rows).sum(), ..Table::default() };
        let longest = parts.iter().map(|t| t.rows).max()?;
        for (at, column) in first.columns.iter().enumerate() {
            let mut cells = column.cells.of_same_kind();
            let others = parts.iter().map(|t| t.columns.get(at).filter(|c| c.name == column.name));
            let others = others.collect::<Option<Vec<_>>>()?;
            for row in 0..longest {
                for (other, part) in others.iter().zip(parts) {
                    if row < part.rows && !cells.push_of(&other.cells, row) {
                        return None;
                    }
                }
            }
            whole.put(&column.name, cells);
        }
        let as_wide = parts.iter().all(|t| t.columns.len() == first.columns.len());
        as_wide.then_some(whole)
    }

    fn attempts(&mut self, all: &[Option<&Attempt>], keys: &Keys) {
        fn each<T>(all: &[Option<&Attempt>], of: impl Fn(&Attempt) -> Option<T>) -> Vec<Option<T>> {
            all.iter().map(|a| a.and_then(&of)).collect()
        }
        self.put("module", Cells::Text(each(all, |a| Some(a.module.clone()))));
        self.put("level", Cells::Natural(each(all, |a| Some(u64::from(a.level)))));
        self.put("surgeon", Cells::Text(each(all, |a| a.surgeon.clone())));
        self.put("seed", Cells::Natural(each(all, |a| a.seed)));
        self.put("program", Cells::Text(each(all, |a| Some(a.program.clone()))));
        self.put("score_version", Cells::Natural(each(all, |a| Some(u64::from(a.score_version)))));
        self.put("finished", Cells::Truth(each(all, |a| Some(a.finished))));
        self.put("failed", Cells::Text(each(all, |a| a.failed.clone())));
        self.put("took_s", Cells::Real(each(all, |a| Some(a.took_s))));
        self.put("total", Cells::Real(each(all, |a| Some(a.total))));
        self.put("sigma", Cells::Real(each(all, |a| Some(a.sigma))));
        let find = |points: &[Points], key: &str| points.iter().find(|p| p.key == key).cloned();
        for key in &keys.categories {
            let points = each(all, |a| Some(find(&a.categories, key)?.points));
            self.put(&format!("category_{key}"), Cells::Real(points));
        }
        for key in &keys.metrics {
            self.put(&format!("value_{key}"), Cells::Real(each(all, |a| find(&a.metrics, key)?.value)));
            let points = each(all, |a| Some(find(&a.metrics, key)?.points));
            self.put(&format!("points_{key}"), Cells::Real(points));
        }
        self.put("recording", Cells::Text(each(all, |a| a.recording.clone())));
        self.put("recording_sha256", Cells::Text(each(all, |a| a.recording_sha256.clone())));
    }

    /// Writes comma-separated values after RFC 4180, with a line of names.
    ///
    /// # Errors
    /// If `out` refuses.
    pub fn write_csv(&self, out: &mut impl Write) -> io::Result<()> {
        let mut out = csv::Writer::from_writer(out);
        out.write_record(self.columns.iter().map(|c| &c.name))?;
        for row in 0..self.rows {
            out.write_record(self.columns.iter().map(|c| c.cells.to_csv(row)))?;
        }
        out.flush()
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use std::path::PathBuf;

    pub(crate) fn keys() -> Keys {
        Keys { categories: vec!["target".into()], metrics: vec!["speed-near-retina".into()] }
    }

    /// A scored recording, one without a value, and one that could not be read.
    pub(crate) fn rows() -> Vec<Row> {
        let metric =
            |value| Points { key: "speed-near-retina".into(), value, points: 0.1 + 0.2, ..Points::default() };
        let attempt = Attempt {
            module: "shadow".into(),
            level: 1,
            seed: Some(u64::MAX),
            total: 100.0 / 3.0,
            categories: vec![Points { key: "target".into(), points: 8.0, ..Points::default() }],
            metrics: vec![metric(Some(-0.0))],
            ..Attempt::default()
        };
        let other = Attempt { metrics: vec![metric(None)], ..attempt.clone() };
        let row = |file: &str, problem: Option<&str>, attempt| Row {
            file: PathBuf::from(file),
            problem: problem.map(Into::into),
            seconds: 2.5,
            ended: true,
            agrees: None,
            attempt,
            sha256: problem.is_none().then(|| "ab".repeat(32)),
        };
        vec![
            row("a.mcap", None, Some(attempt)),
            row("b, c.mcap", Some("cut at \"9\""), Some(other)),
            row("d.mcap", Some("no recording"), None),
        ]
    }

    #[test]
    fn csv_has_a_cell_for_every_column_and_quotes_what_needs_it() {
        let table = Table::of_batch(&rows(), &keys());
        let mut out = Vec::new();
        table.write_csv(&mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 4);
        assert!(
            lines[0].starts_with("file,problem,seconds,ended,agrees,module,level,")
                && lines[0].contains(",value_speed_near_retina,")
        );
        assert!(lines[1].contains(",18446744073709551615,") && lines[1].contains(",33.333333333333336,"));
        assert!(lines[2].starts_with("\"b, c.mcap\",\"cut at \"\"9\"\"\",2.5,true,,shadow,1,"));
        assert_eq!(lines[3], format!("d.mcap,no recording,2.5{}", ",".repeat(table.columns.len() - 3)));
    }

    #[test]
    fn columns_depend_on_the_keys_alone() {
        let names = |rows: &[Row]| -> Vec<String> {
            Table::of_batch(rows, &keys()).columns.into_iter().map(|c| c.name).collect()
        };
        assert_eq!(names(&rows()), names(&[]));
        let mut wide = keys();
        wide.widen(&Attempt {
            metrics: vec![Points { key: "old".into(), ..Points::default() }],
            ..Attempt::default()
        });
        assert_eq!(wide.metrics, ["speed-near-retina", "old"]);
    }
}
