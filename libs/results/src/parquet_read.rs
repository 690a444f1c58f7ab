//! Reading a table back from the Parquet file that [`super::parquet_file`] wrote.
//!
//! The library panics on some damaged files (a negative length in the footer). A damaged table is a
//! finding and no reason to end, so such a panic is caught here, and is an error like the others.

use crate::table::{Cells, Column, Table};
use parquet::basic::{LogicalType, Type as Physical};
use parquet::errors::ParquetError;
use parquet::file::reader::{ChunkReader, FileReader, SerializedFileReader};
use parquet::record::Field;
use parquet::schema::types::Type;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

/// A table, and the notes in its metadata.
pub type Noted = (Table, BTreeMap<String, String>);

/// Reads a table whole.
///
/// # Errors
/// Where it is no Parquet file, ends early, or has columns of a kind that no table of ours has.
pub fn read<R: ChunkReader + 'static>(from: R) -> Result<Noted, ParquetError> {
    // What a panic may leave half done goes with the reader.
    let read = quietly(|| catch_unwind(AssertUnwindSafe(|| read_undamaged(from))));
    read.unwrap_or_else(|_| Err(ParquetError::General("its footer or a page is invalid".into())))
}

thread_local! {
    static QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Does something whose panics are caught, and so are not shown.
fn quietly<T>(work: impl FnOnce() -> T) -> T {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |about| {
            if !QUIET.get() {
                usual(about);
            }
        }));
    });
    let before = QUIET.replace(true);
    let done = work();
    QUIET.set(before);
    done
}

fn read_undamaged<R: ChunkReader + 'static>(from: R) -> Result<Noted, ParquetError> {
    let reader = SerializedFileReader::new(from)?;
    let about = reader.metadata().file_metadata();
    let notes = about.key_value_metadata().into_iter().flatten();
    let notes = notes.filter_map(|note| Some((note.key.clone(), note.value.clone()?))).collect();
    let fields = about.schema().get_fields();
    let columns = fields.iter().map(|field| column(field)).collect::<Result<Vec<_>, _>>()?;
    let mut table = Table { columns, rows: 0 };
    for row in reader.get_row_iter(None)? {
        let row = row?;
        let mut cells = row.get_column_iter();
        for column in &mut table.columns {
            let field = cells.next().map(|(_, field)| field);
            put(column, field.ok_or_else(|| strange(&column.name))?)?;
        }
        table.rows += 1;
    }
    Ok((table, notes))
}

/// An empty column for a field of the schema.
fn column(field: &Type) -> Result<Column, ParquetError> {
    let name = field.name().to_owned();
    if !field.is_primitive() {
        return Err(strange(&name));
    }
    let logical = field.get_basic_info().logical_type_ref();
    let natural = matches!(logical, Some(LogicalType::Integer(kind)) if !kind.is_signed);
    let cells = match field.get_physical_type() {
        Physical::BYTE_ARRAY => Cells::Text(Vec::new()),
        Physical::INT64 if natural => Cells::Natural(Vec::new()),
        Physical::INT64 => Cells::Whole(Vec::new()),
        Physical::DOUBLE => Cells::Real(Vec::new()),
        Physical::BOOLEAN => Cells::Truth(Vec::new()),
        _ => return Err(strange(&name)),
    };
    Ok(Column { name, cells })
}

fn put(column: &mut Column, field: &Field) -> Result<(), ParquetError> {
    match (&mut column.cells, field) {
        (Cells::Text(to), Field::Str(text)) => to.push(Some(text.clone())),
        (Cells::Text(to), Field::Null) => to.push(None),
        (Cells::Whole(to), Field::Long(number)) => to.push(Some(*number)),
        (Cells::Whole(to), Field::Null) => to.push(None),
        (Cells::Natural(to), Field::ULong(number)) => to.push(Some(*number)),
        (Cells::Natural(to), Field::Null) => to.push(None),
        (Cells::Real(to), Field::Double(number)) => to.push(Some(*number)),
        (Cells::Real(to), Field::Null) => to.push(None),
        (Cells::Truth(to), Field::Bool(truth)) => to.push(Some(*truth)),
        (Cells::Truth(to), Field::Null) => to.push(None),
        _ => return Err(strange(&column.name)),
    }
    Ok(())
}

fn strange(column: &str) -> ParquetError {
    ParquetError::General(format!("column '{column}' has a type that vitreo's tables do not have"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parquet_file::write;
    use crate::table::tests::{keys, rows};
    use proptest::prelude::*;
    use std::fs::File;
    use std::io::{Seek, Write};

    fn written() -> Vec<u8> {
        let mut bytes = Vec::new();
        write(&Table::of_batch(&rows(), &keys()), &mut bytes, &[("shard", "0/1")]).unwrap();
        bytes
    }

    fn file_of(bytes: &[u8]) -> File {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(bytes).unwrap();
        file.rewind().unwrap();
        file
    }

    #[test]
    fn what_was_written_is_read_again() {
        let (table, notes) = read(file_of(&written())).unwrap();
        assert_eq!(table, Table::of_batch(&rows(), &keys()));
        assert_eq!(notes["shard"], "0/1");
        let mut empty = Vec::new();
        write(&Table::of_batch(&[], &keys()), &mut empty, &[]).unwrap();
        assert_eq!(read(file_of(&empty)).unwrap().0, Table::of_batch(&[], &keys()));
    }

    proptest! {
        #[test]
        fn a_file_that_ends_early_is_refused(share in 0.0f64..1.0) {
            let whole = written();
            let kept = (whole.len() as f64 * share) as usize;
            prop_assert!(read(file_of(&whole[..kept])).is_err());
        }

        #[test]
        fn any_damage_is_refused_or_gives_a_table(at in 0.0f64..1.0, with in any::<u8>()) {
            let mut bytes = written();
            let place = (bytes.len() as f64 * at) as usize;
            bytes[place] = with;
            if let Ok((table, _)) = read(file_of(&bytes)) {
                prop_assert!(table.columns.iter().all(|c| c.cells.len() == table.rows));
            }
        }
    }
}
