using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.Runtime.InteropServices;
using System.Security.Cryptography;

namespace Hapticnet
{
    /// <summary>What masters and slaves have in common.</summary>
    public abstract class Node : IDisposable
    {
        private static readonly double MicrosecondsPerTick = 1e6 / Stopwatch.Frequency;
        private static readonly Lazy<int> Largest =
            new Lazy<int>(() => Native.Loaded(() => (int)Native.hn_datagram_bytes()));
        private static readonly byte[][] CountNames =
            { Native.Bytes("malformed"), Native.Bytes("stray"), Native.Bytes("too_old") };

        private GCHandle _pinned;

        internal Node(int axes, Func<uint> random)
        {
            Axes = axes;
            Random = new RandomSource(random ?? SystemRandom());
            _pinned = GCHandle.Alloc(Random);
        }

        /// <summary>The most bytes of a datagram.</summary>
        public static int DatagramBytes
        {
            get { return Largest.Value; }
        }

        /// <summary>Size of a buffer to receive into: a byte more, so that a longer datagram is seen.</summary>
        public static int ReceiveBytes
        {
            get { return Largest.Value + 1; }
        }

        /// <summary>The present time [µs] of a monotonic clock. Any other of a program's own will do as well.</summary>
        public static long NowUs
        {
            get { return (long)(Stopwatch.GetTimestamp() * MicrosecondsPerTick); }
        }

        /// <summary>The names of all codecs.</summary>
        public static IList<string> Codecs
        {
            get
            {
                var names = new List<string>();
                for (uint i = 0; Native.Loaded(() => Native.hn_codec_name(i)) != IntPtr.Zero; i++)
                    names.Add(Native.Text(Native.hn_codec_name(i)));
                return names;
            }
        }

        /// <summary>Number of axes, 1 to 3: how many elements of positions [m] and forces [N] are used.</summary>
        public int Axes { get; private set; }

        /// <summary>Datagrams that were dropped because they are malformed, or belong to no session; and answers that
        /// came too late.</summary>
        public Counts Counts
        {
            get { return new Counts(Count(CountNames[0]), Count(CountNames[1]), Count(CountNames[2])); }
        }

        internal RandomSource Random { get; private set; }

        internal IntPtr Context
        {
            get { return GCHandle.ToIntPtr(_pinned); }
        }

        /// <summary>Free the memory, and overwrite the keys in it.</summary>
        public abstract void Dispose();

        internal abstract uint Count(byte[] name);

        /// <summary>Let a handle keep what native code points to.</summary>
        internal void Hand(NodeHandle handle)
        {
            handle.Keep(_pinned);
        }

        /// <summary>Release what a node keeps that could not be made.</summary>
        internal void Abandon()
        {
            _pinned.Free();
        }

        internal void CheckVector(double[] vector, string what)
        {
            if (vector == null || vector.Length < Axes)
                throw new HapticException(what + " has " + (vector == null ? 0 : vector.Length)
                    + " elements; it needs one for each axis: " + Axes);
        }

        internal static void CheckBuffer(byte[] buffer)
        {
            if (buffer == null || buffer.Length < DatagramBytes)
                throw new HapticException("the buffer has " + (buffer == null ? 0 : buffer.Length)
                    + " bytes; a datagram can have " + DatagramBytes);
        }

        internal static void CheckSize(byte[] bytes, int size, string what)
        {
            if (bytes == null || size < 0 || size > bytes.Length)
                throw new HapticException(what + " is said to have " + size + " bytes, but the array has "
                    + (bytes == null ? 0 : bytes.Length));
        }

        private static Func<uint> SystemRandom()
        {
            var system = RandomNumberGenerator.Create();
            var bytes = new byte[4];
            return () =>
            {
                system.GetBytes(bytes);
                return BitConverter.ToUInt32(bytes, 0);
            };
        }
    }

    /// <summary>Datagrams that a node dropped or took too late.</summary>
    public struct Counts
    {
        internal Counts(uint malformed, uint stray, uint tooOld)
            : this()
        {
            Malformed = malformed;
            Stray = stray;
            TooOld = tooOld;
        }

        /// <summary>Datagrams that cannot be read, or whose seal is broken.</summary>
        public uint Malformed { get; private set; }

        /// <summary>Datagrams that belong to no session of this node.</summary>
        public uint Stray { get; private set; }

        /// <summary>Answers to positions that were more than a second old.</summary>
        public uint TooOld { get; private set; }
    }
}
