using System;
using System.Collections.Generic;
using System.Runtime.InteropServices;

namespace Hapticnet
{
    /// <summary>The slave's end, of one master at a time, with the codecs deadband and raw.</summary>
    /// <remarks>Receive all that has arrived. If there is a position then, give <see cref="Answer"/> the force there;
    /// what it writes goes to <see cref="MasterAddress"/>. One thread at a time may use it.</remarks>
    public sealed class Slave : Node
    {
        /// <summary>The most bytes of an address.</summary>
        public const int AddressBytes = 28;

        private readonly SlaveHandle _handle;

        /// <summary>Make a slave.</summary>
        /// <param name="scene">The name of what is touched: printable, at most 64 bytes of UTF-8.</param>
        /// <param name="axes">1 to 3.</param>
        /// <param name="random">Returns 32 unpredictable bits. Null: the system's.</param>
        public Slave(string scene, int axes = 1, Func<uint> random = null)
            : base(axes, random)
        {
            var wrong = new byte[(int)Native.Loaded(Native.hn_error_bytes)];
            try
            {
                _handle = Native.Loaded(() => Native.hn_make_slave(Native.Bytes(scene ?? ""), (uint)axes,
                    RandomSource.Callback, Context, wrong));
            }
            finally
            {
                if (_handle == null || _handle.IsInvalid)
                    Abandon();
                else
                    Hand(_handle);
            }
            Native.Check(_handle, wrong);
        }

        /// <summary>The address of the session's master, as it was given to <see cref="Receive"/>; null without one.
        /// </summary>
        public byte[] MasterAddress
        {
            get
            {
                UIntPtr size;
                IntPtr at = Native.hn_slave_master(_handle, out size);
                if (at == IntPtr.Zero)
                    return null;
                var address = new byte[(int)size];
                Marshal.Copy(at, address, 0, address.Length);
                return address;
            }
        }

        /// <summary>Serve sealed sessions only, of these masters. Call it before the first datagram.</summary>
        public void Seal(PrivateKey key, IList<ListedMaster> masters)
        {
            var listed = new byte[64 * masters.Count];
            for (int i = 0; i < masters.Count; i++)
            {
                PrivateKey.CheckLength(masters[i].PublicKey, "a master's public key");
                masters[i].PublicKey.CopyTo(listed, 64 * i);
                if (masters[i].Psk != null)
                    masters[i].Psk.CopyTo(listed, 64 * i + 32);
            }
            Native.Check(Native.hn_seal_slave(_handle, key.Own, listed, (UIntPtr)masters.Count));
            Array.Clear(listed, 0, listed.Length);
        }

        /// <summary>Take in a datagram; write the answer to where it came from, and return its size, or 0.</summary>
        public int Receive(byte[] datagram, int size, byte[] address, int addressSize, long nowUs, byte[] answer)
        {
            CheckSize(datagram, size, "the datagram");
            CheckSize(address, addressSize, "the address");
            CheckBuffer(answer);
            if (addressSize > AddressBytes)
                throw new HapticException("the address has " + addressSize + " bytes; it can have " + AddressBytes);
            int answered = (int)Native.hn_slave_receive(_handle, datagram, (UIntPtr)size, address, (UIntPtr)addressSize,
                nowUs, answer);
            Random.Check();
            return answered;
        }

        /// <summary>Write the position [m] that waits for its force; return whether there is one.</summary>
        public bool Position(double[] positionM)
        {
            CheckVector(positionM, "the position");
            return Native.hn_slave_position(_handle, positionM);
        }

        /// <summary>Write the answer: the force [N] that pushes the tool out. Return its size, or 0.</summary>
        /// <remarks>A force that is not finite ends the session.</remarks>
        public int Answer(double[] forceN, long nowUs, byte[] answer)
        {
            CheckVector(forceN, "the force");
            CheckBuffer(answer);
            return (int)Native.hn_slave_answer(_handle, forceN, nowUs, answer);
        }

        /// <summary>End the session; write the datagram that tells the master. Return its size, or 0.</summary>
        public int Close(string reason, int code, byte[] datagram)
        {
            CheckBuffer(datagram);
            return (int)Native.hn_slave_close(_handle, Native.Bytes(reason ?? ""), (uint)code, datagram);
        }

        /// <inheritdoc/>
        public override void Dispose()
        {
            _handle.Dispose();
        }

        internal override uint Count(byte[] name)
        {
            return Native.hn_slave_count(_handle, name);
        }
    }
}
