//! Tables as Parquet files, which pandas, DuckDB, R and Spark read as they are.

use crate::table::{Cells, Column, Table};
use parquet::basic::{Compression, IntType, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};
use std::io::Write;
use std::sync::Arc;

/// Rows of a group: what a reader takes in at a time.
const GROUP: usize = 65_536;

/// Writes a table as a Parquet file into `out`. `notes` go into its metadata.
///
/// # Errors
/// If `out` refuses.
pub fn write<W: Write + Send>(table: &Table, out: W, notes: &[(&str, &str)]) -> Result<(), ParquetError> {
    let note = |(key, value): &(&str, &str)| KeyValue::new((*key).into(), Some((*value).into()));
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(Default::default()))
        .set_created_by(concat!("vitreo ", env!("CARGO_PKG_VERSION")).into())
        .set_key_value_metadata(Some(notes.iter().map(note).collect()))
        .build();
    let mut writer = SerializedFileWriter::new(out, schema(table)?, Arc::new(properties))?;
    for start in (0..table.rows).step_by(GROUP) {
        let end = table.rows.min(start + GROUP);
        let mut group = writer.next_row_group()?;
        for column in &table.columns {
            put(&mut group, column, start, end)?;
        }
        group.close()?;
    }
    writer.close().map(drop)
}

fn schema(table: &Table) -> Result<TypePtr, ParquetError> {
    let fields = table.columns.iter().map(|column| {
        let natural = IntType { bit_width: 64, is_signed: false };
        let (physical, logical) = match column.cells {
            Cells::Text(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
            Cells::Whole(_) => (Physical::INT64, None),
            Cells::Natural(_) => (Physical::INT64, Some(LogicalType::Integer(natural))),
            Cells::Real(_) => (Physical::DOUBLE, None),
            Cells::Truth(_) => (Physical::BOOLEAN, None),
        };
        let field = Type::primitive_type_builder(&column.name, physical);
        field.with_repetition(Repetition::OPTIONAL).with_logical_type(logical).build().map(Arc::new)
    });
    let fields = fields.collect::<Result<Vec<_>, _>>()?;
    Ok(Arc::new(Type::group_type_builder("attempts").with_fields(fields).build()?))
}

fn put<W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    column: &Column,
    start: usize,
    end: usize,
) -> Result<(), ParquetError> {
    match &column.cells {
        Cells::Text(c) => {
            cells::<ByteArrayType, _, _>(group, &c[start..end], |t| ByteArray::from(t.as_str()))
        }
        Cells::Whole(c) => cells::<Int64Type, _, _>(group, &c[start..end], |n| *n),
        // The format keeps unsigned numbers in the same bits.
        Cells::Natural(c) => cells::<Int64Type, _, _>(group, &c[start..end], |n| *n as i64),
        Cells::Real(c) => cells::<DoubleType, _, _>(group, &c[start..end], |x| *x),
        Cells::Truth(c) => cells::<BoolType, _, _>(group, &c[start..end], |b| *b),
    }
}

/// Writes the next column of a group: the values that are there, and for each row whether there is
/// one.
fn cells<D: DataType, T, W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    cells: &[Option<T>],
    value: impl Fn(&T) -> D::T,
) -> Result<(), ParquetError> {
    let values: Vec<D::T> = cells.iter().flatten().map(value).collect();
    let there: Vec<i16> = cells.iter().map(|c| i16::from(c.is_some())).collect();
    let lacking = || ParquetError::General("the table has more columns than its schema".into());
    let mut writer = group.next_column()?.ok_or_else(lacking)?;
    writer.typed::<D>().write_batch(&values, Some(&there), None)?;
    writer.close()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::tests::{keys, rows};
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::Field;
    use std::fs::File;

    #[test]
    fn another_reader_finds_the_same_cells() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scores.parquet");
        let table = Table::of_batch(&rows(), &keys());
        write(&table, File::create(&path).unwrap(), &[("shard", "0/1")]).unwrap();
        let reader = SerializedFileReader::new(File::open(&path).unwrap()).unwrap();
        let notes = reader.metadata().file_metadata().key_value_metadata().unwrap();
        assert!(notes.iter().any(|n| n.key == "shard" && n.value.as_deref() == Some("0/1")));
        let read: Vec<_> = reader.get_row_iter(None).unwrap().map(Result::unwrap).collect();
        assert_eq!(read.len(), 3);
        let cell = |row: usize, name: &str| -> Field {
            let found = read[row].get_column_iter().find(|(n, _)| *n == name);
            found.unwrap_or_else(|| panic!("{name}")).1.clone()
        };
        assert_eq!(cell(1, "file"), Field::Str("b, c.mcap".into()));
        assert_eq!(cell(0, "problem"), Field::Null);
        assert_eq!(cell(0, "seed"), Field::ULong(u64::MAX));
        assert_eq!(cell(2, "total"), Field::Null);
        assert_eq!(cell(0, "finished"), Field::Bool(false));
        let Field::Double(zero) = cell(0, "value_speed_near_retina") else { panic!("no number") };
        assert_eq!(zero.to_bits(), (-0.0f64).to_bits());
        assert_eq!(cell(1, "value_speed_near_retina"), Field::Null);
    }

    #[test]
    fn an_empty_table_is_a_file_with_columns() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("empty.parquet");
        write(&Table::of_batch(&[], &keys()), File::create(&path).unwrap(), &[]).unwrap();
        let reader = SerializedFileReader::new(File::open(&path).unwrap()).unwrap();
        assert_eq!(reader.metadata().file_metadata().num_rows(), 0);
        assert!(reader.metadata().file_metadata().schema().get_fields().len() > 10);
    }
}
