//! Writing of Parquet files.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::basic::{Compression, ConvertedType, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type};
use parquet::errors::{ParquetError, Result};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnPath, PrimitiveTypeBuilder, Type, TypePtr};

use crate::error::StoreError;

/// The values of a column for all rows of a row group.
pub(super) enum Values<'a> {
    Integers(&'a [i64]),
    Floats(&'a [f32]),
    Doubles(&'a [f64]),
    /// A list of this many values in each row, row by row.
    Vectors(&'a [f32], usize),
    Texts(&'a [&'a str]),
    /// A list of one text in each row.
    TextLists(&'a [&'a str]),
    /// Encoded images in the form of the library `datasets`: bytes without a path.
    Images(&'a [ByteArray]),
}

/// The name and the values of a column.
pub(super) type Column<'a> = (&'static str, Values<'a>);

/// A Parquet file that is written one row group at a time.
pub(super) struct Table {
    path: PathBuf,
    writer: SerializedFileWriter<File>,
}

impl Table {
    /// Creates a file with columns of these names and types. The values are not written.
    pub(super) fn create(
        path: &Path,
        columns: &[Column<'_>],
    ) -> std::result::Result<Self, StoreError> {
        let folder = path.parent().unwrap_or(path);
        std::fs::create_dir_all(folder).map_err(StoreError::output(folder))?;
        let file = File::create(path).map_err(StoreError::output(path))?;
        let writer = schema(columns)
            .and_then(|schema| {
                SerializedFileWriter::new(file, schema, Arc::new(properties(columns)))
            })
            .map_err(failed(path))?;
        Ok(Self { path: path.to_owned(), writer })
    }

    /// Appends a row group.
    pub(super) fn append(&mut self, columns: &[Column<'_>]) -> std::result::Result<(), StoreError> {
        self.try_append(columns).map_err(failed(&self.path))
    }

    fn try_append(&mut self, columns: &[Column<'_>]) -> Result<()> {
        let mut group = self.writer.next_row_group()?;
        columns.iter().try_for_each(|(_, values)| put_column(&mut group, values))?;
        group.close().map(drop)
    }

    /// The number of bytes written so far.
    pub(super) fn bytes(&self) -> u64 {
        self.writer.bytes_written() as u64
    }

    /// Adds the metadata from which pandas restores its index.
    pub(super) fn for_pandas(&mut self, text: String) {
        self.writer.append_key_value_metadata(KeyValue::new("pandas".to_owned(), text));
    }

    pub(super) fn finish(self) -> std::result::Result<(), StoreError> {
        self.writer.close().map(drop).map_err(failed(&self.path))
    }
}

fn failed(path: &Path) -> impl FnOnce(ParquetError) -> StoreError {
    move |error| StoreError::output(path)(std::io::Error::other(error))
}

fn schema(columns: &[Column<'_>]) -> Result<TypePtr> {
    let fields = columns
        .iter()
        .map(|(name, values)| field(name, values).map(Arc::new))
        .collect::<Result<_>>()?;
    Type::group_type_builder("schema").with_fields(fields).build().map(Arc::new)
}

fn field(name: &str, values: &Values<'_>) -> Result<Type> {
    match values {
        Values::Integers(_) => primitive(name, Physical::INT64).build(),
        Values::Floats(_) => primitive(name, Physical::FLOAT).build(),
        Values::Doubles(_) => primitive(name, Physical::DOUBLE).build(),
        Values::Texts(_) => string(name).build(),
        Values::Vectors(..) => list(name, primitive("element", Physical::FLOAT).build()?),
        Values::TextLists(_) => list(name, string("element").build()?),
        Values::Images(_) => {
            let bytes = primitive("bytes", Physical::BYTE_ARRAY).build()?;
            let path = string("path").with_repetition(Repetition::OPTIONAL).build()?;
            group(name, Repetition::REQUIRED, vec![bytes, path])
        }
    }
}

fn primitive(name: &str, physical: Physical) -> PrimitiveTypeBuilder<'_> {
    Type::primitive_type_builder(name, physical).with_repetition(Repetition::REQUIRED)
}

fn string(name: &str) -> PrimitiveTypeBuilder<'_> {
    primitive(name, Physical::BYTE_ARRAY)
        .with_converted_type(ConvertedType::UTF8)
        .with_logical_type(Some(LogicalType::String))
}

/// A list as in Parquet's "Logical Types": a group that contains a repeated group `list` of `element`.
fn list(name: &str, element: Type) -> Result<Type> {
    let repeated = group("list", Repetition::REPEATED, vec![element])?;
    Type::group_type_builder(name)
        .with_repetition(Repetition::REQUIRED)
        .with_converted_type(ConvertedType::LIST)
        .with_logical_type(Some(LogicalType::List))
        .with_fields(vec![Arc::new(repeated)])
        .build()
}

fn group(name: &str, repetition: Repetition, fields: Vec<Type>) -> Result<Type> {
    let fields = fields.into_iter().map(Arc::new).collect();
    Type::group_type_builder(name).with_repetition(repetition).with_fields(fields).build()
}

fn properties(columns: &[Column<'_>]) -> WriterProperties {
    let mut properties = WriterProperties::builder().set_compression(Compression::SNAPPY);
    for (name, _) in columns.iter().filter(|(_, values)| matches!(values, Values::Images(_))) {
        // PNGs are compressed already, all different, and have no meaningful order.
        let path = ColumnPath::new(vec![(*name).to_owned(), "bytes".to_owned()]);
        properties = properties
            .set_column_compression(path.clone(), Compression::UNCOMPRESSED)
            .set_column_dictionary_enabled(path.clone(), false)
            .set_column_statistics_enabled(path, EnabledStatistics::None);
    }
    properties.build()
}

fn put_column(group: &mut SerializedRowGroupWriter<'_, File>, values: &Values<'_>) -> Result<()> {
    match values {
        Values::Integers(values) => put::<Int64Type>(group, values, None, None),
        Values::Floats(values) => put::<FloatType>(group, values, None, None),
        Values::Doubles(values) => put::<DoubleType>(group, values, None, None),
        Values::Texts(values) => put::<ByteArrayType>(group, &byte_arrays(values), None, None),
        Values::TextLists(values) => {
            let (defined, repeated) = levels(values.len(), 1);
            put::<ByteArrayType>(group, &byte_arrays(values), Some(&defined), Some(&repeated))
        }
        Values::Vectors(values, width) => {
            let (defined, repeated) = levels(values.len(), *width);
            put::<FloatType>(group, values, Some(&defined), Some(&repeated))
        }
        Values::Images(values) => {
            put::<ByteArrayType>(group, values, None, None)?;
            // Level 0: the path is null.
            put::<ByteArrayType>(group, &[], Some(&vec![0; values.len()]), None)
        }
    }
}

fn byte_arrays(texts: &[&str]) -> Vec<ByteArray> {
    texts.iter().map(|text| ByteArray::from(*text)).collect()
}

/// Definition and repetition levels of lists of `width` values: every value is present, and every `width`-th begins a list.
fn levels(count: usize, width: usize) -> (Vec<i16>, Vec<i16>) {
    (vec![1; count], (0..count).map(|at| i16::from(at % width.max(1) != 0)).collect())
}

fn put<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, File>,
    values: &[T::T],
    defined: Option<&[i16]>,
    repeated: Option<&[i16]>,
) -> Result<()> {
    let Some(mut column) = group.next_column()? else {
        return Err(ParquetError::General("more columns than the schema has".to_owned()));
    };
    column.typed::<T>().write_batch(values, defined, repeated)?;
    column.close()
}
