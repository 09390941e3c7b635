//! The slave: positions in, forces out.

use std::ffi::CString;
use std::ptr::NonNull;
use std::slice;

use crate::random::{draw, Source};
use crate::{c_text, check, counted, made, sys, Counts, Datagram, Error, Listed, PrivateKey, Random, Vector};
use crate::{ADDRESS_BYTES, MOST_AXES};

/// A slave of one master at a time, with the codecs deadband and raw. Receive all that has arrived; if there is a position
/// then, give `answer` the force there.
pub struct Slave {
    node: NonNull<sys::Slave>,
    axes: usize,
    _source: Source, // the node points to it
}

// Safety: as for a master.
unsafe impl Send for Slave {}

impl Slave {
    /// Make a slave whose scene has this name, printable and of at most 64 bytes, and 1 to 3 axes.
    pub fn new(scene: &str, axes: usize, random: Option<Random>) -> Result<Slave, Error> {
        let mut source = Source::new(random);
        let scene = c_text(scene, "the scene's name")?;
        let asked = u32::try_from(axes).unwrap_or(u32::MAX);
        // Safety: the name is copied, and the source lives as long as the node.
        let node =
            made(|wrong| unsafe { sys::hn_make_slave(scene.as_ptr(), asked, draw, source.context(), wrong) })?;
        Ok(Slave { node, axes, _source: source })
    }

    /// Serve sealed sessions only, of these masters. Call it before the first datagram.
    pub fn seal(&mut self, key: &PrivateKey, masters: &[Listed]) -> Result<(), Error> {
        let listed: Vec<u8> = masters.iter().flat_map(|each| each.public.iter().chain(&each.psk).copied()).collect();
        // Safety: each takes 64 bytes, which are copied.
        check(unsafe { sys::hn_seal_slave(self.node.as_ptr(), key.own.as_ptr(), listed.as_ptr(), masters.len()) })
    }

    /// Take in a datagram; return the answer to where it came from, which is an address in bytes of your own.
    ///
    /// # Panics
    ///
    /// If the address has more than `ADDRESS_BYTES`.
    pub fn receive(&mut self, datagram: &[u8], address: &[u8], now_us: i64) -> Option<Datagram> {
        assert!(address.len() <= ADDRESS_BYTES, "an address has at most {} bytes", ADDRESS_BYTES);
        // Safety: it reads that many bytes, and writes at most DATAGRAM_BYTES.
        Datagram::written(|bytes| unsafe {
            sys::hn_slave_receive(
                self.node.as_ptr(),
                datagram.as_ptr().cast(),
                datagram.len(),
                address.as_ptr().cast(),
                address.len(),
                now_us,
                bytes,
            )
        })
    }

    /// Return the position that waits for its force.
    pub fn position(&self) -> Option<Vector> {
        let mut position_m = [0.0; MOST_AXES];
        // Safety: it writes one element for each axis.
        unsafe { sys::hn_slave_position(self.node.as_ptr(), position_m.as_mut_ptr()) }.then(|| position_m)
    }

    /// Return the answer: the force that pushes the tool out. One that is not finite ends the session.
    ///
    /// # Panics
    ///
    /// If it has fewer elements than the scene has axes.
    pub fn answer(&mut self, force_n: &[f64], now_us: i64) -> Option<Datagram> {
        assert!(force_n.len() >= self.axes, "a force needs each axis");
        // Safety: it reads one element for each axis, and writes at most DATAGRAM_BYTES.
        Datagram::written(|bytes| unsafe { sys::hn_slave_answer(self.node.as_ptr(), force_n.as_ptr(), now_us, bytes) })
    }

    /// End the session; return the datagram that tells the master.
    pub fn close(&mut self, reason: &str, code: u32) -> Option<Datagram> {
        let reason = CString::new(reason.replace('\0', "")).expect("no zero is left");
        // Safety: the reason is copied, and at most DATAGRAM_BYTES are written.
        Datagram::written(|bytes| unsafe { sys::hn_slave_close(self.node.as_ptr(), reason.as_ptr(), code, bytes) })
    }

    /// Return the address of the session's master, as `receive` was given it.
    pub fn master(&self) -> Option<&[u8]> {
        let mut size = 0;
        // Safety: the address has that many bytes, and stays until the slave changes.
        let at = unsafe { sys::hn_slave_master(self.node.as_ptr(), &mut size) };
        (!at.is_null()).then(|| unsafe { slice::from_raw_parts(at.cast(), size) })
    }

    /// Return how many datagrams were dropped.
    pub fn counts(&self) -> Counts {
        counted(|name| unsafe { sys::hn_slave_count(self.node.as_ptr(), name) })
    }
}

impl Drop for Slave {
    fn drop(&mut self) {
        // Safety: nobody else has the node.
        unsafe { sys::hn_free_slave(self.node.as_ptr()) }
    }
}
