//! Declares a section of the configuration: one entry for each key, from which everything else follows.
//!
//! [`settings!`](crate::settings!) makes a struct, its [`Default`], its serde implementation (unknown keys are refused) and
//! [`Section`], the description of its keys. The program that reads the configuration uses that description to check a file,
//! to write the commented default file and to write the reference table, so that a default, a range or a sentence about a
//! key is in one place.
//!
//! Rules between keys (`max` above `min`) are ordinary functions beside the section.

use alloc::{string::String, vec::Vec};
use core::fmt;

/// The keys of one section, in the order of the file.
#[derive(Debug)]
pub struct Section {
    /// What the section is about, one element for each line of the struct's documentation.
    pub about: &'static [&'static str],
    pub keys: &'static [Key],
}

/// One key of the configuration.
#[derive(Debug)]
pub struct Key {
    /// Name in the file, which is also the name of the field.
    pub name: &'static str,
    /// What it means, one element for each line of the field's documentation.
    pub about: &'static [&'static str],
    /// The type of its value.
    pub kind: Kind,
    /// What its numbers may be; `None` where the type alone decides.
    pub range: Option<Range>,
    /// Unit of its numbers, or empty.
    pub unit: &'static str,
    /// Where the default comes from, or empty.
    pub source: &'static str,
    /// The name that it had before. A file with that name is refused with the new one; recordings with it can be read.
    pub was: Option<&'static str>,
}

/// The type of a value.
#[derive(Debug)]
pub enum Kind {
    /// `true` or `false`.
    Bool,
    /// A whole number.
    Integer,
    /// A number with or without a fraction.
    Number,
    /// Any text, as far as serde accepts it.
    Text,
    /// One of these texts.
    Choice(&'static [&'static str]),
    /// The text `auto` or a whole number.
    AutoOrInteger,
    /// A list of values of one type; of exactly this length where one is given.
    List(&'static Kind, Option<usize>),
    /// A table with keys of its own.
    Table(&'static Section),
    /// Anything that serde accepts, described for the user.
    Other(&'static str),
}

/// What a number may be, both ends included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// The smallest allowed value.
    pub min: f64,
    /// The largest allowed value.
    pub max: f64,
    /// Both and the unit, as the user reads them.
    pub text: &'static str,
}

impl Range {
    /// Whether the range contains this value. No range contains NaN.
    #[must_use]
    pub fn allows(&self, value: f64) -> bool {
        self.min <= value && value <= self.max
    }
}

/// A number is outside of the range of its key.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutOfRange {
    /// Name of the key.
    pub key: &'static str,
    /// The number that is out of range.
    pub value: f64,
    /// The allowed range and its unit.
    pub allowed: &'static str,
}

impl fmt::Display for OutOfRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{} = {}` is out of range; allowed: {}", self.key, self.value, self.allowed)
    }
}

impl core::error::Error for OutOfRange {}

/// A type that a key of the configuration can have.
pub trait ConfigValue {
    /// How the value is written in the file.
    const KIND: Kind;

    /// The first number in this value that `range` does not allow.
    fn first_outside(&self, _range: &Range) -> Option<f64> {
        None
    }

    /// Checks the numbers in this value against the range of its key.
    ///
    /// # Errors
    /// The first number that is out of range. NaN is out of every range.
    fn check(&self, key: &Key) -> Result<(), OutOfRange> {
        let Some(range) = &key.range else { return Ok(()) };
        match self.first_outside(range) {
            Some(value) => Err(OutOfRange { key: key.name, value, allowed: range.text }),
            None => Ok(()),
        }
    }
}

macro_rules! integers {
    ($($ty:ty),*) => {$(
        impl ConfigValue for $ty {
            const KIND: Kind = Kind::Integer;

            fn first_outside(&self, range: &Range) -> Option<f64> {
                (*self as f64).first_outside(range)
            }
        }
    )*};
}

integers!(u8, u16, u32, u64, usize, i16, i32, i64);

impl ConfigValue for f64 {
    const KIND: Kind = Kind::Number;

    fn first_outside(&self, range: &Range) -> Option<f64> {
        (!range.allows(*self)).then_some(*self)
    }
}

impl ConfigValue for f32 {
    const KIND: Kind = Kind::Number;

    /// Compares in single precision: the limit 0.99, read as an `f32`, is 0.9900000095 and must be allowed.
    fn first_outside(&self, range: &Range) -> Option<f64> {
        let is_inside = range.min as f32 <= *self && *self <= range.max as f32;
        (!is_inside).then_some(f64::from(*self))
    }
}

impl ConfigValue for bool {
    const KIND: Kind = Kind::Bool;
}

impl ConfigValue for String {
    const KIND: Kind = Kind::Text;
}

/// Without a value, the key is absent from the file.
impl<T: ConfigValue> ConfigValue for Option<T> {
    const KIND: Kind = T::KIND;

    fn first_outside(&self, range: &Range) -> Option<f64> {
        self.as_ref().and_then(|value| value.first_outside(range))
    }
}

impl<T: ConfigValue> ConfigValue for Vec<T> {
    const KIND: Kind = Kind::List(&T::KIND, None);

    fn first_outside(&self, range: &Range) -> Option<f64> {
        self.iter().find_map(|value| value.first_outside(range))
    }
}

impl<T: ConfigValue, const N: usize> ConfigValue for [T; N] {
    const KIND: Kind = Kind::List(&T::KIND, Some(N));

    fn first_outside(&self, range: &Range) -> Option<f64> {
        self.iter().find_map(|value| value.first_outside(range))
    }
}

/// Declares a section of the configuration.
///
/// Each key has a documentation comment, a name, a type and a default. The attributes `in` (smallest and largest allowed
/// number), `unit`, `source` (where the default comes from) and `was` (its former name) follow in this order, each where it
/// applies. A key whose type is another section needs no default.
///
/// The crate that uses it depends on `serde` with its feature `derive`.
///
/// ```ignore
/// hal::settings! {
///     /// The occupancy grid.
///     pub struct MapConfig {
///         /// Side of a cell.
///         cell_m: f64 = 0.03, in 0.005..=1.0, unit "m", source "paper (real robot)";
///         /// What the map takes from the safety LiDAR.
///         lidar: LidarUse = LidarUse::HitsAndFree;
///     }
/// }
/// ```
#[macro_export]
macro_rules! settings {
    (
        $(#[$($section_attribute:tt)*])*
        $visibility:vis struct $Name:ident {
            $(
                $(#[$($attribute:tt)*])*
                $key:ident : $Type:ty $(= $default:expr)?
                $(, in $min:literal ..= $max:literal)?
                $(, unit $unit:literal)?
                $(, source $source:literal)?
                $(, was $was:literal)?
                ;
            )*
        }
    ) => {
        $(#[$($section_attribute)*])*
        #[derive(Debug, Clone, PartialEq, ::serde::Serialize, ::serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        $visibility struct $Name {
            $(
                $(#[$($attribute)*])*
                // Recordings hold the configuration with the names of their time.
                $(#[serde(alias = $was)])?
                pub $key: $Type,
            )*
        }

        impl Default for $Name {
            fn default() -> Self {
                Self { $($key: $crate::__setting_default!($($default)?),)* }
            }
        }

        impl $Name {
            /// The description of every key.
            pub const SECTION: $crate::settings::Section = $crate::settings::Section {
                about: $crate::__setting_about!([] $(#[$($section_attribute)*])*),
                keys: &[$(
                    $crate::settings::Key {
                        name: stringify!($key),
                        about: $crate::__setting_about!([] $(#[$($attribute)*])*),
                        kind: <$Type as $crate::settings::ConfigValue>::KIND,
                        range: $crate::__setting_range!([$($min, $max)?] [$($unit)?]),
                        unit: concat!($($unit)?),
                        source: concat!($($source)?),
                        was: $crate::__setting_was!($($was)?),
                    },
                )*],
            };

            /// Checks every number against the range of its key.
            ///
            /// # Errors
            /// The first number that is out of range. NaN is out of every range.
            pub fn check_ranges(&self) -> Result<(), $crate::settings::OutOfRange> {
                let mut keys = Self::SECTION.keys.iter();
                $(
                    if let Some(key) = keys.next() {
                        $crate::settings::ConfigValue::check(&self.$key, key)?;
                    }
                )*
                Ok(())
            }
        }

        impl $crate::settings::ConfigValue for $Name {
            const KIND: $crate::settings::Kind = $crate::settings::Kind::Table(&Self::SECTION);

            fn check(
                &self,
                _key: &$crate::settings::Key,
            ) -> Result<(), $crate::settings::OutOfRange> {
                self.check_ranges()
            }
        }
    };
}

/// Gives an enum the texts that serde reads it from, so that a key of a [`settings!`](crate::settings!) section can have its
/// type: `hal::choices!(LidarUse: "off", "hits", "hits-and-free");`.
#[macro_export]
macro_rules! choices {
    ($Type:ty: $($name:literal),+ $(,)?) => {
        impl $crate::settings::ConfigValue for $Type {
            const KIND: $crate::settings::Kind = $crate::settings::Kind::Choice(&[$($name),+]);
        }
    };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __setting_default {
    () => {
        Default::default()
    };
    ($default:expr) => {
        $default
    };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __setting_was {
    () => {
        None
    };
    ($was:literal) => {
        Some($was)
    };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __setting_range {
    ([] [$($unit:literal)?]) => {
        None
    };
    ([$min:literal, $max:literal] [$($unit:literal)?]) => {
        Some($crate::settings::Range {
            min: $min as f64,
            max: $max as f64,
            text: concat!($min, " to ", $max $(, " ", $unit)?),
        })
    };
}

/// The lines of the documentation comments among attributes.
#[doc(hidden)]
#[macro_export]
macro_rules! __setting_about {
    ([$($line:expr,)*]) => {
        &[$($line),*]
    };
    ([$($line:expr,)*] #[doc = $next:expr] $($rest:tt)*) => {
        $crate::__setting_about!([$($line,)* $next,] $($rest)*)
    };
    ([$($line:expr,)*] #[$($other:tt)*] $($rest:tt)*) => {
        $crate::__setting_about!([$($line,)*] $($rest)*)
    };
}
