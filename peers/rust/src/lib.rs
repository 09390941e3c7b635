//! Both ends of the hapticnet protocol: a master sends positions and gets forces, a slave answers them.
//!
//! The crate is a safe face of the C library. It does no input or output and reads no clock: give it datagrams and the
//! time, in microseconds of one monotonic clock, and send what it returns. Positions are in metres, forces in newtons.

#![warn(missing_docs)]

mod keys;
mod master;
mod random;
mod slave;
#[allow(missing_docs)]
mod sys;

pub use keys::{load_masters, parse_key, Key, Listed, PrivateKey};
pub use master::{Master, Request, State};
pub use random::Random;
pub use slave::Slave;

use std::ffi::{CStr, CString};
use std::fmt;
use std::ops::Deref;
use std::os::raw::c_char;
use std::ptr::NonNull;

include!(concat!(env!("OUT_DIR"), "/constants.rs"));

/// Size of a buffer to receive into: one byte more, so that a longer datagram is seen to be one.
pub const RECEIVE_BYTES: usize = DATAGRAM_BYTES + 1;

/// The most bytes of an address that a slave takes.
pub const ADDRESS_BYTES: usize = 28;

/// A position [m] or force [N]; what is beyond the axes that are used is zero.
pub type Vector = [f64; MOST_AXES];

/// What was wrong with a request, a key or a file: one sentence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error(String);

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}

/// Datagrams that were dropped: malformed, of no session of this node, and answers that came too late.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct Counts {
    pub malformed: u32,
    pub stray: u32,
    pub too_old: u32,
}

/// A datagram to send.
pub struct Datagram {
    bytes: [u8; DATAGRAM_BYTES],
    size: usize,
}

impl Datagram {
    /// Return what a function writes, and whose size it returns; `None` if that is 0.
    fn written(write: impl FnOnce(*mut u8) -> usize) -> Option<Datagram> {
        let mut bytes = [0; DATAGRAM_BYTES];
        let size = write(bytes.as_mut_ptr());
        (size > 0).then(|| Datagram { bytes, size })
    }
}

impl Deref for Datagram {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes[..self.size]
    }
}

/// Return the names of all codecs.
pub fn codecs() -> Vec<String> {
    (0..)
        .map(|i| unsafe { sys::hn_codec_name(i) })
        .take_while(|name| !name.is_null())
        .map(|name| text_of(name).unwrap_or_default())
        .collect()
}

/// Return a text of the library; `None` for a null pointer.
fn text_of(text: *const c_char) -> Option<String> {
    // Safety: the library's texts end with a zero, and live as long as its node.
    (!text.is_null()).then(|| unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned())
}

/// Return what the library says is wrong as an error.
fn check(wrong: *const c_char) -> Result<(), Error> {
    text_of(wrong).map_or(Ok(()), |wrong| Err(Error(wrong)))
}

/// Return the node that a function of the library makes, or as an error what that writes to memory for it.
fn made<Node>(make: impl FnOnce(*mut c_char) -> *mut Node) -> Result<NonNull<Node>, Error> {
    let mut wrong: Vec<u8> = vec![0; unsafe { sys::hn_error_bytes() }];
    let node = make(wrong.as_mut_ptr().cast());
    NonNull::new(node).ok_or_else(|| Error(text_of(wrong.as_ptr().cast()).unwrap_or_default()))
}

/// Return a text as the library takes it. It cannot have a zero inside.
fn c_text(text: &str, what: &str) -> Result<CString, Error> {
    CString::new(text).map_err(|_| Error(format!("{} has a zero byte", what)))
}

fn counted(count: impl Fn(*const c_char) -> u32) -> Counts {
    let of = |name: &[u8]| count(name.as_ptr().cast());
    Counts { malformed: of(b"malformed\0"), stray: of(b"stray\0"), too_old: of(b"too_old\0") }
}
