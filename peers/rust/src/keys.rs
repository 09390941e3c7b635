//! Keys of sealed sessions, and hapticnet's key files.

use std::ffi::CString;
use std::path::Path;
use std::ptr::{null, write_volatile};

use crate::{c_text, check, sys, Error};

/// A key.
pub type Key = [u8; 32];

/// A host's own key, and the one that it shares with its peer: zeros if there is none. It overwrites itself.
pub struct PrivateKey {
    pub(crate) own: Key,
    pub(crate) psk: Key,
}

impl PrivateKey {
    /// Make one of its bytes.
    pub fn new(own: Key, psk: Option<Key>) -> PrivateKey {
        PrivateKey { own, psk: psk.unwrap_or_default() }
    }

    /// Read the file that 'hapticnet key new' made; `None`: ~/.config/hapticnet/key.toml.
    pub fn load(path: Option<&Path>) -> Result<PrivateKey, Error> {
        let path = c_path(path)?;
        let mut key = PrivateKey { own: [0; 32], psk: [0; 32] };
        // Safety: keys have 32 bytes, and the error as many as the library says.
        read(|wrong| unsafe {
            let path = path.as_ref().map_or(null(), |path| path.as_ptr());
            check(sys::hn_read_key(path, key.own.as_mut_ptr(), key.psk.as_mut_ptr(), wrong.as_mut_ptr().cast()))
        })?;
        Ok(key)
    }

    /// Return the public key, which the peer needs.
    pub fn public(&self) -> Result<Key, Error> {
        let mut public = [0; 32];
        // Safety: keys have 32 bytes.
        let good = unsafe { sys::hn_derive_public(public.as_mut_ptr(), self.own.as_ptr()) };
        good.then(|| public).ok_or_else(|| Error("libcrypto lacks X25519, as in FIPS mode".into()))
    }
}

impl Drop for PrivateKey {
    fn drop(&mut self) {
        for byte in self.own.iter_mut().chain(&mut self.psk) {
            // Safety: it is a reference. A plain assignment could be left out.
            unsafe { write_volatile(byte, 0) };
        }
    }
}

/// A master that a slave serves; `psk` is zeros if they share no key.
#[derive(Clone)]
pub struct Listed {
    /// Its public key.
    pub public: Key,
    /// The key that both share.
    pub psk: Key,
}

/// Read a slave's list of masters; `None`: ~/.config/hapticnet/masters.toml.
pub fn load_masters(path: Option<&Path>) -> Result<Vec<Listed>, Error> {
    const MOST: usize = 1000;
    let path = c_path(path)?;
    let mut listed = vec![[[0; 32]; 2]; MOST];
    let mut count = 0;
    // Safety: there are MOST times 64 bytes.
    read(|wrong| unsafe {
        let path = path.as_ref().map_or(null(), |path| path.as_ptr());
        check(sys::hn_read_masters(path, listed.as_mut_ptr().cast(), MOST, &mut count, wrong.as_mut_ptr().cast()))
    })?;
    Ok(listed[..count].iter().map(|&[public, psk]| Listed { public, psk }).collect())
}

/// Return the bytes of a key that is written as 44 characters of base64.
pub fn parse_key(text: &str) -> Result<Key, Error> {
    let mut key = [0; 32];
    let wrong = || {
        let size = text.len();
        Error(format!("a key is 44 characters of base64 that end in '=' (32 bytes); this has {} characters", size))
    };
    let text = c_text(text, "a key").map_err(|_| wrong())?;
    // Safety: a key has 32 bytes.
    unsafe { sys::hn_parse_key(key.as_mut_ptr(), text.as_ptr()) }.then(|| key).ok_or_else(wrong)
}

fn c_path(path: Option<&Path>) -> Result<Option<CString>, Error> {
    path.map(|path| c_text(&path.to_string_lossy(), "the path")).transpose()
}

/// Give a function memory for the text of an error.
fn read(call: impl FnOnce(&mut [u8]) -> Result<(), Error>) -> Result<(), Error> {
    call(&mut vec![0; unsafe { sys::hn_error_bytes() }])
}
